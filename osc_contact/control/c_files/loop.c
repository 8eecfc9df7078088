/* A loop in real time under Linux, with a recording in place of a robot:
 *
 *     loop [RATE in Hz [SECONDS [CONTROLLER RECORDING]]]
 *
 * Where real-time scheduling and locked memory are not permitted, it reports that and runs without.
 * Latency is the time from a deadline until the loop runs; a deadline is missed where the torques of
 * the one before are not there yet. */
#define _POSIX_C_SOURCE 200112L
#include "recording.h"

#include <errno.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>

enum { SECOND = 1000000000, PRIORITY = 80 }; /* below the kernel's own threads at 99 */

static int64_t now(void) { /* ns */
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * SECOND + t.tv_nsec;
}

static void wait_until(int64_t time) {
    struct timespec t = {(time_t)(time / SECOND), (long)(time % SECOND)};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR) {}
}

static void enter_real_time(void) {
    struct sched_param priority;
    memset(&priority, 0, sizeof priority);
    priority.sched_priority = PRIORITY;
    if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0)
        printf("without locked memory: %s; ulimit -l permits it\n", strerror(errno));
    if (sched_setscheduler(0, SCHED_FIFO, &priority) != 0)
        printf("without SCHED_FIFO: %s; ulimit -r permits it\n", strerror(errno));
}

static void show(const char *name, double *us, size_t count) {
    sort(us, count);
    printf("%s: %.1f µs p50, %.1f µs p99, %.1f µs p99.9, %.1f µs max\n", name, quantile(us, count, 0.5),
           quantile(us, count, 0.99), quantile(us, count, 0.999), us[count - 1]);
}

static void show_histogram(const double *sorted, size_t count) {
    size_t at = 0;
    for (double edge = 1.0; at < count; edge *= 2.0) {
        size_t first = at;
        while (at < count && sorted[at] < edge) at++;
        if (at > first) printf("  below %8.0f µs: %zu\n", edge, at - first);
    }
}

int main(int count, char **words) {
    double rate = count > 1 ? atof(words[1]) : 1000.0, seconds = count > 2 ? atof(words[2]) : 10.0;
    if (!(rate >= 1.0 && rate <= 1e5 && seconds * rate >= 1.0 && seconds <= 3600.0)) {
        fprintf(stderr, "loop [RATE in Hz [SECONDS [CONTROLLER RECORDING]]]\n");
        return 2;
    }
    osc_controller *c;
    recording tape;
    open_both(3, count, words, &c, &tape);
    size_t ticks = (size_t)(rate * seconds), missed = 0;
    double *latency = malloc(ticks * sizeof *latency), *work = malloc(ticks * sizeof *work);
    double *torques = malloc(tape.n.motors * sizeof *torques);
    void *first = malloc(tape.memory_bytes);
    if (latency == NULL || work == NULL || torques == NULL || first == NULL) return 2;
    memset(latency, 0, ticks * sizeof *latency); /* pages are mapped before the loop, not within it */
    memset(work, 0, ticks * sizeof *work);
    require(osc_get_memory(c, first, tape.memory_bytes), "controller");
    enter_real_time();

    int64_t period = (int64_t)(SECOND / rate), deadline = now() + period, left = tape.count;
    for (size_t i = 0; i < ticks; i++, left--) {
        if (left == 0) { /* once more from the start */
            rewind_recording(&tape);
            require(osc_set_memory(c, first, tape.memory_bytes), "controller");
            left = tape.count;
        }
        wait_until(deadline);
        int64_t awake = now();
        recorded_tick t = next_tick(&tape, c); /* here: read the robot */
        osc_command out = {torques, tape.n.motors, 0, 0, 0, 0, 0, 0};
        require(osc_tick(c, &t.m, &t.r, &out), "tick"); /* then: send the torques */
        int64_t done = now();
        latency[i] = 1e-3 * (double)(awake - deadline);
        work[i] = 1e-3 * (double)(done - awake);
        for (deadline += period; deadline <= done; deadline += period) missed++;
    }

    struct sched_param normal;
    memset(&normal, 0, sizeof normal);
    sched_setscheduler(0, SCHED_OTHER, &normal);
    printf("%zu ticks at %g Hz, %zu deadlines missed\n", ticks, rate, missed);
    show("tick", work, ticks);
    show("latency", latency, ticks);
    show_histogram(latency, ticks);
    free(first);
    free(torques);
    free(work);
    free(latency);
    free(tape.bytes);
    osc_destroy(c);
    return 0;
}
