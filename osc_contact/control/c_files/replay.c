/* Replays a recording of ticks: are all torques equal to the last bit, and how long do ticks take? */
#define _POSIX_C_SOURCE 199309L
#include "recording.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

int main(int count, char **words) {
    osc_controller *c;
    recording tape;
    open_both(1, count, words, &c, &tape);
    size_t ticks = (size_t)tape.count, equal = 0, ends[5] = {0}, bytes = 8 * tape.n.motors;
    double *times = calloc(ticks, sizeof *times), *torques = calloc(tape.n.motors, sizeof *torques);
    if (times == NULL || torques == NULL) return 2;
    for (size_t i = 0; i < ticks; i++) {
        struct timespec from, to;
        osc_command out = {torques, tape.n.motors, 0, 0, 0, 0, 0, 0};
        recorded_tick t = next_tick(&tape, c);
        clock_gettime(CLOCK_MONOTONIC, &from);
        int code = osc_tick(c, &t.m, &t.r, &out);
        clock_gettime(CLOCK_MONOTONIC, &to);
        require(code, "tick");
        times[i] = 1e6 * (double)(to.tv_sec - from.tv_sec) + 1e-3 * (double)(to.tv_nsec - from.tv_nsec);
        ends[out.status % 5]++;
        equal += memcmp(torques, t.torques, bytes) == 0 && out.status == t.status;
    }
    sort(times, ticks);
    printf("%zu of %zu ticks bit-equal; %.1f µs median, %.1f µs p99.9, %.1f µs worst\n", equal, ticks,
           quantile(times, ticks, 0.5), quantile(times, ticks, 0.999), times[ticks - 1]);
    printf("%zu ticks ended OK, %zu SATURATED, %zu HELD, %zu DEGRADED, %zu HOPPING\n", ends[0], ends[1],
           ends[2], ends[3], ends[4]);
    free(times);
    free(torques);
    free(tape.bytes);
    osc_destroy(c);
    return equal == ticks ? 0 : 1;
}
