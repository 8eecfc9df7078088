/* Reads a controller with some of its words replaced and the checksum made right again, many times
 * over, and runs those that are accepted:
 *
 *     crafted CONTROLLER RECORDING PATCHES
 *
 * A patch is the number of words (8 bytes), then for each its place behind the head and its value.
 * Prints what became of each: its error code; 1: torques finite and within the limits; 2: not;
 * 3: bytes that nothing may change were changed; 4: the process crashed; 5: it did not end.
 *
 * The controller's bytes lie between pages that nobody may touch: accesses of the compiled law, which
 * no sanitizer looks into, are found out there. */
#define _GNU_SOURCE
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

enum { GUARD = 1 << 24, PAGE = 4096, SOUND = 1, WRONG_TORQUES, OVERWRITTEN, CRASHED, ENDLESS };

static struct { unsigned char *start, *given; size_t bytes; } guarded[4];

static void *allocate_guarded(size_t alignment, size_t size) {
    size_t pages = (size + PAGE - 1) / PAGE * PAGE;
    unsigned char *start = mmap(NULL, pages + 2 * GUARD, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    (void)alignment;
    for (int i = 0; i < 4 && start != MAP_FAILED; i++)
        if (guarded[i].start == NULL) {
            mprotect(start + GUARD, pages, PROT_READ | PROT_WRITE);
            guarded[i].start = start;
            guarded[i].bytes = pages + 2 * GUARD;
            return guarded[i].given = start + GUARD + pages - size;
        }
    return NULL;
}

static void release(void *at) {
    for (int i = 0; i < 4; i++)
        if (at != NULL && guarded[i].given == at) {
            munmap(guarded[i].start, guarded[i].bytes);
            memset(&guarded[i], 0, sizeof *guarded);
            return;
        }
    free(at);
}

#define aligned_alloc allocate_guarded
#define free release
#include "osc_controller.c"
#undef free
#include "recording.h"

static int sound(osc_controller *c, const double *torques) {
    const unsigned char *joint = c->model + whole(c->model, 8 * MODEL_joints);
    for (size_t j = 0; j < c->dimensions.joints; j++, joint += JOINT_BYTES) {
        int64_t motor = whole(joint, JOINT_MOTOR);
        double limit = *(const double *)(const void *)(joint + JOINT_TAU_MAX);
        if (motor < 0) continue;
        if (motor >= (int64_t)c->dimensions.motors || !isfinite(torques[motor])) return 0;
        if (!(fabs(torques[motor]) <= limit * (1.0 + 1e-12))) return 0;
    }
    return 1;
}

/* One tick, of the recording or without readings. */
static int tick_soundly(osc_controller *c, recorded_tick *t, double *torques, int blind) {
    osc_command out;
    double *none = c->missing;
    osc_measurement m = t->m;
    memset(&out, 0, sizeof out);
    out.torques = torques;
    out.count = c->dimensions.motors;
    if (blind & 1) m.q.data = none;
    if (blind & 2) m.v.data = none;
    if (blind & 4) m.wrenches.data = none;
    require(osc_tick(c, &m, &t->r, &out), "tick");
    return sound(c, torques);
}

static int run_all(osc_controller *c, recording *tape, double *torques) {
    recorded_tick t;
    void *memory = malloc(tape->memory_bytes);
    double tare[6];
    int fine = 1;
    rewind_recording(tape);
    for (int64_t i = 0; i < tape->count; i++) {
        t = next_tick(tape, c);
        fine &= tick_soundly(c, &t, torques, 0);
    }
    for (int i = 0; i < 8; i++) fine &= tick_soundly(c, &t, torques, i);
    osc_get_tare(c, tare);
    osc_set_gain(c, "motion.integral", 0.0);
    osc_set_gain(c, "force.integral", 1.0);
    for (int i = 0; i < 2; i++) fine &= tick_soundly(c, &t, torques, 0);
    require(osc_get_memory(c, memory, tape->memory_bytes), "memory");
    osc_set_memory(c, memory, tape->memory_bytes);
    osc_reset(c);
    for (int i = 0; i < 3; i++) fine &= tick_soundly(c, &t, torques, 0);
    for (int i = 0; i < 30; i++) fine &= tick_soundly(c, &t, torques, 5); /* until it stops */
    free(memory);
    return fine;
}

static int try_file(const unsigned char *file, size_t size, recording *tape) {
    osc_controller *c;
    int code = osc_create_from(file, size, &c);
    if (code != OSC_DONE) return c == NULL ? code : OVERWRITTEN;
    osc_get_dimensions(c, &tape->n);
    tape->memory_bytes = (size_t)whole(c->model, MODEL_memory_bytes);
    size_t bytes = (size_t)whole(c->model, MODEL_row_bytes);
    unsigned char *model = malloc(bytes);
    double *torques = calloc(c->dimensions.motors + 1, sizeof *torques);
    size_t layout = 8 * MEMORY_LAYOUT_WORDS;
    unsigned char *before = malloc(layout);
    memcpy(model, c->model, bytes);
    memcpy(before, c->memory, layout);
    int ended = run_all(c, tape, torques) ? SOUND : WRONG_TORQUES;
    memcpy(model + MODEL_integral, c->model + MODEL_integral, 8); /* these two were set */
    memcpy(model + MODEL_force_gain, c->model + MODEL_force_gain, 8);
    if (memcmp(model, c->model, bytes) || memcmp(before, c->memory, layout)) ended = OVERWRITTEN;
    free(before);
    free(torques);
    free(model);
    osc_destroy(c);
    return ended;
}

int main(int count, char **words) {
    osc_controller *c;
    recording tape;
    if (count != 4) return 2;
    open_both(1, count, words, &c, &tape);
    osc_destroy(c);
    FILE *stream = fopen(words[1], "rb"), *patches = fopen(words[3], "rb");
    unsigned char *file = malloc(1 << 22), *copy = malloc(1 << 22);
    size_t size = fread(file, 1, 1 << 22, stream);
    uint64_t patched;
    /* What children have found so far, and which one they are at: a crash ends a child only. */
    struct { int64_t at, counted; int ended[1 << 20]; } *found = mmap(
        NULL, sizeof *found, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    int status = 1;
    for (int64_t from = 0; status; from = found->at + 1) {
        fflush(stdout);
        pid_t child = fork();
        if (child == 0) {
            rewind(patches);
            for (int64_t i = 0; fread(&patched, 8, 1, patches) == 1; i++) {
                memcpy(copy, file, size);
                for (uint64_t k = 0; k < patched; k++) {
                    uint64_t word[2];
                    if (fread(word, 8, 2, patches) != 2) _exit(0);
                    memcpy(copy + OSC_FILE_HEAD + word[0], &word[1], 8);
                }
                if (i < from) continue;
                uint32_t sum = checksum(copy, size - 4);
                memcpy(copy + size - 4, &sum, 4);
                found->at = i;
                alarm(20);
                unsigned char *exact = malloc(size); /* of this size, so that ASan sees beyond */
                memcpy(exact, copy, size);
                found->ended[i] = try_file(exact, size, &tape);
                free(exact);
                found->counted = i + 1;
            }
            _exit(0);
        }
        waitpid(child, &status, 0);
        if (status == 0) break;
        found->ended[found->at] = WIFSIGNALED(status) && WTERMSIG(status) == SIGALRM ? ENDLESS : CRASHED;
        found->counted = found->at + 1;
    }
    for (int64_t i = 0; i < found->counted; i++) printf("%d\n", found->ended[i]);
    fclose(stream);
    fclose(patches);
    free(file);
    free(copy);
    free(tape.bytes);
    return 0;
}
