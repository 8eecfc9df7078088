/* Replays a recording of ticks: are all torques equal to the last bit, and how long do ticks take? */
#define _POSIX_C_SOURCE 199309L
#include "osc_controller.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { MEMORY = 1, TOUCHED = 2, WRENCH_MISSING = 4, ESTIMATED = 8, SQUEEZE = 16, REPEATED = 5 };

static unsigned char *next, *end;

static void *take(size_t bytes) {
    unsigned char *at = next;
    if (bytes > (size_t)(end - next)) {
        fprintf(stderr, "the recording is too short\n");
        exit(2);
    }
    next += bytes;
    return at;
}

static osc_numbers take_numbers(size_t count) {
    osc_numbers x = {take(8 * count), count};
    return x;
}

static int by_size(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* A file beside this program, unless the words of its call name another. */
static const char *path_of(int number, const char *name, int count, char **words) {
    static char path[2][4096];
    const char *slash = strrchr(words[0], '/');
    if (count > number) return words[number];
    snprintf(path[number - 1], sizeof path[0], "%.*s%s", slash ? (int)(slash - words[0] + 1) : 0, words[0],
             name);
    return path[number - 1];
}

int main(int count, char **words) {
    osc_controller *c;
    osc_dimensions n;
    FILE *stream;
    int code = osc_create(path_of(1, "controller.osc", count, words), &c);
    if (code != OSC_DONE) {
        fprintf(stderr, "controller: %s\n", osc_error_text(code));
        return 2;
    }
    osc_get_dimensions(c, &n);
    if ((stream = fopen(path_of(2, "recording.osc", count, words), "rb")) == NULL) return 2;
    fseek(stream, 0, SEEK_END);
    size_t size = (size_t)ftell(stream);
    rewind(stream);
    unsigned char *all = malloc(size);
    if (all == NULL || fread(all, 1, size, stream) != size) return 2;
    fclose(stream);
    next = all;
    end = all + size;
    if (memcmp(take(8), "OSCTAPE1", 8) != 0) return 2;
    int64_t ticks = *(int64_t *)take(8), memory_bytes = *(int64_t *)take(8), equal = 0, ends[4] = {0};
    double *times = calloc((size_t)ticks, sizeof *times), *torques = calloc(n.motors, sizeof *torques);
    for (int64_t i = 0; i < ticks; i++) {
        int64_t flags = *(int64_t *)take(8), status = *(int64_t *)take(8);
        struct timespec from, to;
        osc_measurement m;
        osc_reference r;
        osc_command out = {torques, n.motors, 0, 0, 0, 0};
        if (flags & MEMORY && osc_set_memory(c, take((size_t)memory_bytes), (size_t)memory_bytes)) return 2;
        m.q = take_numbers(n.joints);
        m.v = take_numbers(n.joints);
        m.wrenches = take_numbers(6 * n.arms);
        r.X_WD = take_numbers(16);
        r.V_D = take_numbers(6);
        r.A_D = take_numbers(6);
        r.alpha_d = take_numbers(n.forces);
        r.squeeze_d = take_numbers(flags & SQUEEZE ? n.bars : 0);
        m.touched = take_numbers(flags & TOUCHED ? 28 * n.contacts : 0);
        m.wrench_missing = (flags & WRENCH_MISSING) != 0;
        m.estimated = (flags & ESTIMATED) != 0;
        m.repeated = (int32_t)(flags >> REPEATED);
        const double *wanted = take(8 * n.motors);
        clock_gettime(CLOCK_MONOTONIC, &from);
        code = osc_tick(c, &m, &r, &out);
        clock_gettime(CLOCK_MONOTONIC, &to);
        times[i] = 1e6 * (double)(to.tv_sec - from.tv_sec) + 1e-3 * (double)(to.tv_nsec - from.tv_nsec);
        if (code != OSC_DONE) {
            fprintf(stderr, "tick %lld: %s\n", (long long)i, osc_error_text(code));
            return 2;
        }
        ends[out.status & 3]++;
        equal += memcmp(torques, wanted, 8 * n.motors) == 0 && out.status == status;
    }
    qsort(times, (size_t)ticks, sizeof *times, by_size);
    printf("%lld of %lld ticks bit-equal; %.1f µs median, %.1f µs p99.9, %.1f µs worst\n", (long long)equal,
           (long long)ticks, times[ticks / 2], times[ticks - 1 - ticks / 1000], times[ticks - 1]);
    printf("%lld ticks ended OK, %lld SATURATED, %lld HELD, %lld DEGRADED\n", (long long)ends[0],
           (long long)ends[1], (long long)ends[2], (long long)ends[3]);
    free(times);
    free(torques);
    free(all);
    osc_destroy(c);
    return equal == ticks ? 0 : 1;
}
