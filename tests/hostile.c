/* Calls that a careless program makes: each must end in an error code. Prints what does not. */
#include "osc_controller.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int wrong;

#define EXPECT(call, code)                                             \
    do {                                                               \
        int got = (call);                                              \
        if (got != (code)) {                                           \
            printf("%d: %s is %d, not %s\n", __LINE__, #call, got, #code); \
            wrong = 1;                                                 \
        }                                                              \
    } while (0)

static unsigned char *file;
static size_t size;
static osc_dimensions n;

struct call {
    osc_controller *c;
    osc_measurement m;
    osc_reference r;
    osc_command out;
    double *numbers;
};

static osc_numbers part(double **from, size_t count) {
    osc_numbers x = {*from, count};
    *from += count;
    return x;
}

static struct call call_of(osc_controller *c) {
    struct call one = {c, {{0}}, {{0}}, {0}, calloc(1000, sizeof(double))};
    double *at = one.numbers;
    one.m.q = part(&at, n.joints);
    one.m.v = part(&at, n.joints);
    one.m.wrenches = part(&at, 6 * n.arms);
    one.r.X_WD = part(&at, 16);
    for (int i = 0; i < 16; i += 5) one.numbers[one.r.X_WD.data - one.numbers + i] = 1.0;
    one.r.V_D = part(&at, 6);
    one.r.A_D = part(&at, 6);
    one.r.alpha_d = part(&at, n.forces);
    one.r.active = part(&at, n.contacts);
    one.out.torques = at;
    one.out.count = n.motors;
    return one;
}

static int tick(struct call *one) { return osc_tick(one->c, &one->m, &one->r, &one->out); }

static void *many(void *given) {
    struct call *one = given;
    for (int i = 0; i < 2000; i++) EXPECT(tick(one), OSC_DONE);
    return NULL;
}

static void files(void) {
    osc_controller *c;
    unsigned char *copy = malloc(size);
    EXPECT(osc_create(NULL, &c), OSC_NULL);
    EXPECT(osc_create("no such file", &c), OSC_NO_FILE);
    EXPECT(osc_create_from(file, size, NULL), OSC_NULL);
    EXPECT(osc_create_from(NULL, size, &c), OSC_NULL);
    for (size_t cut = 0; cut < size; cut += 1 + cut / 7) {
        unsigned char *less = malloc(cut ? cut : 1); /* of this size, so that ASan sees beyond */
        memcpy(less, file, cut);
        EXPECT(osc_create_from(less, cut, &c), cut < 100 ? OSC_NOT_A_CONTROLLER : OSC_DAMAGED);
        free(less);
    }
    for (size_t at = 0; at < size; at += 1 + at / 9) {
        memcpy(copy, file, size);
        copy[at] ^= 8;
        EXPECT(osc_create_from(copy, size, &c),
               at < 8 ? OSC_NOT_A_CONTROLLER : at < 12 ? OSC_OTHER_FORMAT : OSC_DAMAGED);
        if (c != NULL) wrong = 1;
    }
    memset(copy, 'x', size);
    EXPECT(osc_create_from(copy, size, &c), OSC_NOT_A_CONTROLLER);
    free(copy);
}

static void ticks(osc_controller *c) {
    struct call good = call_of(c), bad;
    double wrench[6] = {0}, nan_wrench[6];
    memset(nan_wrench, 255, sizeof nan_wrench);
    EXPECT(osc_tick(NULL, &good.m, &good.r, &good.out), OSC_NULL);
    EXPECT(osc_tick(c, NULL, &good.r, &good.out), OSC_NULL);
    EXPECT(osc_tick(c, &good.m, NULL, &good.out), OSC_NULL);
    EXPECT(osc_tick(c, &good.m, &good.r, NULL), OSC_NULL);
    osc_numbers *fields[] = {&bad.m.q, &bad.m.v, &bad.m.wrenches, &bad.r.X_WD, &bad.r.V_D, &bad.r.A_D};
    for (int i = 0; i < 6; i++) {
        bad = good;
        fields[i]->data = NULL;
        EXPECT(tick(&bad), OSC_NULL);
        bad = good;
        fields[i]->count += 1;
        EXPECT(tick(&bad), OSC_WRONG_SIZE);
        bad = good;
        fields[i]->count = (size_t)-1;
        EXPECT(tick(&bad), OSC_WRONG_SIZE);
        bad = good;
        fields[i]->data = (const double *)((uintptr_t)fields[i]->data + 4);
        EXPECT(tick(&bad), OSC_UNALIGNED);
    }
    bad = good;
    bad.m.touched.count = 27;
    EXPECT(tick(&bad), OSC_WRONG_SIZE);
    bad = good;
    bad.out.count = n.motors - 1;
    EXPECT(tick(&bad), OSC_WRONG_SIZE);
    bad = good;
    bad.out.torques = NULL;
    EXPECT(tick(&bad), OSC_NULL);
    EXPECT(tick(&good), OSC_DONE);
    EXPECT(osc_set_gain(c, NULL, 1.0), OSC_NULL);
    EXPECT(osc_set_gain(c, "motion.stiffnes", 1.0), OSC_UNKNOWN_NAME);
    EXPECT(osc_set_gain(c, "motion.stiffness", -1.0), OSC_OUT_OF_RANGE);
    EXPECT(osc_set_gain(c, "motion.stiffness", nan_wrench[0]), OSC_OUT_OF_RANGE);
    EXPECT(osc_set_tare(c, nan_wrench), OSC_OUT_OF_RANGE);
    EXPECT(osc_set_tare(c, NULL), OSC_NULL);
    EXPECT(osc_get_tare(c, wrench), OSC_DONE);
    EXPECT(osc_get_memory(c, wrench, sizeof wrench), OSC_WRONG_SIZE);
    EXPECT(osc_set_memory(c, wrench, sizeof wrench), OSC_WRONG_SIZE);
    EXPECT(osc_reset(NULL), OSC_NULL);
    osc_destroy(NULL);
    free(good.numbers);
}

static void reports(osc_controller *c) {
    double value, six[6], *many = calloc(2 * n.joints + n.forces + 1, sizeof *many);
    int32_t *phases = calloc(n.contacts + 1, sizeof *phases);
    size_t rank;
    EXPECT(osc_get_forces(c, NULL, n.forces), OSC_NULL);
    EXPECT(osc_get_forces(c, many, n.forces + 1), OSC_WRONG_SIZE);
    EXPECT(osc_get_forces(c, many, n.forces), OSC_DONE);
    EXPECT(osc_get_phases(NULL, phases, n.contacts), OSC_NULL);
    EXPECT(osc_get_phases(c, phases, n.contacts + 1), OSC_WRONG_SIZE);
    EXPECT(osc_get_phases(c, phases, n.contacts), OSC_DONE);
    EXPECT(osc_get_motion_integral(c, NULL), OSC_NULL);
    EXPECT(osc_get_motion_integral(c, six), OSC_DONE);
    EXPECT(osc_get_force_integral(c, six, NULL), OSC_NULL);
    EXPECT(osc_get_force_integral(c, six, &rank), OSC_DONE);
    EXPECT(osc_get_friction(c, many, n.joints), OSC_WRONG_SIZE);
    EXPECT(osc_get_friction(c, many, 2 * n.joints), OSC_DONE);
    EXPECT(osc_engage(NULL), OSC_NULL);
    EXPECT(osc_engage(c), OSC_DONE);
    EXPECT(osc_set_phase_setting(c, NULL, 1.0), OSC_NULL);
    EXPECT(osc_set_phase_setting(c, "sped", 0.01), OSC_UNKNOWN_NAME);
    EXPECT(osc_set_phase_setting(c, "speed", 0.0), OSC_OUT_OF_RANGE);
    EXPECT(osc_set_phase_setting(c, "speed", 1e-4), OSC_OUT_OF_RANGE);
    EXPECT(osc_set_phase_setting(c, "speed", 0.02), OSC_DONE);
    EXPECT(osc_get_phase_setting(c, "speed", NULL), OSC_NULL);
    EXPECT(osc_get_phase_setting(c, "speed", &value), OSC_DONE);
    if (osc_reason_text(-1) == NULL || value != 0.02) wrong = 1;
    free(phases);
    free(many);
}

int main(int count, char **words) {
    FILE *stream = count > 1 ? fopen(words[1], "rb") : NULL;
    osc_controller *c[2];
    struct call calls[2];
    pthread_t other;
    if (stream == NULL) return 2;
    file = malloc(1 << 22);
    size = fread(file, 1, 1 << 22, stream);
    fclose(stream);
    files();
    for (int i = 0; i < 2; i++) EXPECT(osc_create(words[1], &c[i]), OSC_DONE);
    EXPECT(osc_get_dimensions(c[0], &n), OSC_DONE);
    EXPECT(osc_get_dimensions(c[0], NULL), OSC_NULL);
    ticks(c[0]);
    reports(c[0]);
    for (int i = 0; i < 2; i++) {
        osc_destroy(c[i]);
        EXPECT(osc_create(words[1], &c[i]), OSC_DONE);
        calls[i] = call_of(c[i]);
    }
    pthread_create(&other, NULL, many, &calls[1]);
    many(&calls[0]);
    pthread_join(other, NULL);
    if (memcmp(calls[0].out.torques, calls[1].out.torques, n.motors * sizeof(double))) wrong = 1;
    for (int i = 0; i < 2; i++) {
        osc_destroy(c[i]);
        free(calls[i].numbers);
    }
    free(file);
    if (!wrong) printf("every call ended as it should\n");
    return wrong;
}
