#include "recording.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MEMORY = 1, TOUCHED = 2, WRENCH_MISSING = 4, ESTIMATED = 8, SQUEEZE = 16, ACTIVE = 32,
       NOISY = 64, REPEATED = 7 };

static void fail(const char *what, const char *why) {
    fprintf(stderr, "%s: %s\n", what, why);
    exit(2);
}

void require(int error, const char *what) {
    if (error != OSC_DONE) fail(what, osc_error_text(error));
}

static const void *take(recording *tape, size_t bytes) {
    const unsigned char *at = tape->bytes + tape->at;
    if (bytes > tape->size - tape->at) fail("recording", "it is too short");
    tape->at += bytes;
    return at;
}

static int64_t take_whole(recording *tape) { return *(const int64_t *)take(tape, 8); }

static osc_numbers take_numbers(recording *tape, size_t count) {
    osc_numbers x = {take(tape, 8 * count), count};
    return x;
}

/* A file beside this program, unless the words of its call name another. */
static const char *path_of(int number, const char *name, int count, char **words) {
    static char path[4096];
    const char *slash = strrchr(words[0], '/');
    if (count > number) return words[number];
    snprintf(path, sizeof path, "%.*s%s", slash ? (int)(slash - words[0] + 1) : 0, words[0], name);
    return path;
}

void rewind_recording(recording *tape) {
    tape->at = 0;
    if (memcmp(take(tape, 8), "OSCTAPE4", 8) != 0) fail("recording", "not a recording of this version");
    tape->count = take_whole(tape);
    tape->memory_bytes = (size_t)take_whole(tape);
    if (tape->count < 1) fail("recording", "it has no ticks");
}

void open_both(int first, int count, char **words, osc_controller **c, recording *tape) {
    require(osc_create(path_of(first, "controller.osc", count, words), c), "controller");
    osc_get_dimensions(*c, &tape->n);
    FILE *stream = fopen(path_of(first + 1, "recording.osc", count, words), "rb");
    if (stream == NULL) fail("recording", "the file cannot be read");
    fseek(stream, 0, SEEK_END);
    tape->size = (size_t)ftell(stream);
    rewind(stream);
    tape->bytes = malloc(tape->size);
    if (tape->bytes == NULL || fread(tape->bytes, 1, tape->size, stream) != tape->size)
        fail("recording", "the file cannot be read");
    fclose(stream);
    rewind_recording(tape);
}

recorded_tick next_tick(recording *tape, osc_controller *c) {
    const osc_dimensions *n = &tape->n;
    recorded_tick t;
    int64_t flags = take_whole(tape);
    t.status = take_whole(tape);
    t.m.wrench_age = (int32_t)take_whole(tape);
    t.memory = flags & MEMORY ? take(tape, tape->memory_bytes) : NULL;
    t.m.q = take_numbers(tape, n->joints);
    t.m.v = take_numbers(tape, n->joints);
    t.m.wrenches = take_numbers(tape, 6 * n->arms);
    t.r.X_WD = take_numbers(tape, 16);
    t.r.V_D = take_numbers(tape, 6);
    t.r.A_D = take_numbers(tape, 6);
    t.r.alpha_d = take_numbers(tape, n->forces);
    t.r.squeeze_d = take_numbers(tape, flags & SQUEEZE ? n->bars : 0);
    t.m.touched = take_numbers(tape, flags & TOUCHED ? 28 * n->contacts : 0);
    t.r.active = take_numbers(tape, flags & ACTIVE ? n->contacts : 0);
    t.m.wrench_missing = (flags & WRENCH_MISSING) != 0;
    t.m.estimated = ((flags & ESTIMATED) != 0) + ((flags & NOISY) != 0);
    t.m.repeated = (int32_t)(flags >> REPEATED);
    t.torques = take(tape, 8 * n->motors);
    if (t.memory != NULL) require(osc_set_memory(c, t.memory, tape->memory_bytes), "recording");
    return t;
}

static int by_size(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

void sort(double *x, size_t count) { qsort(x, count, sizeof *x, by_size); }

double quantile(const double *sorted, size_t count, double share) {
    size_t at = (size_t)(share * (double)count);
    return sorted[at < count ? at : count - 1];
}
