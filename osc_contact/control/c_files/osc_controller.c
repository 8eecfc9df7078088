/* The controller of osc_controller.h around the compiled law, law.o.
 *
 * A controller is one run of bytes, as `osc_contact.law.records.Rows` lays it out, and PROGRAM for
 * ticks beyond the motors' limits. Offsets come from osc_layout.h, which is generated with them.
 */
#include "osc_controller.h"
#include "osc_bytes.h"
#include "osc_daqp.h"
#include "osc_layout.h"
#include "osc_ranges.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The law takes addresses as whole numbers of 64 bits, WebAssembly with its pointers of 32 included. */
extern int32_t osc_law_rows(int64_t *, void **, uint64_t, int64_t, uint64_t, uint64_t);
extern int32_t osc_law_fill(int64_t *, void **, uint64_t, int64_t, int64_t, uint64_t);
extern int32_t osc_law_prepare(int64_t *, void **, uint64_t, int64_t);
extern int32_t osc_law_finish(int64_t *, void **, uint64_t, int64_t);
extern int32_t osc_law_settle(int64_t *, void **, uint64_t, int64_t, int64_t, uint64_t);

static uint64_t address(const void *at) { return (uint64_t)(uintptr_t)at; }

struct osc_controller {
    osc_dimensions dimensions;
    unsigned char *raw, *program, *arena;
    size_t raw_bytes, program_bytes, arena_bytes;
    int64_t *job;
    unsigned char *model, *memory, *work;
    double *missing; /* NaN in place of readings */
    /* in the place of motion filter and control structure, of what comes with it; or null */
    void (*structure)(osc_controller *, const void *);
    const void *of_structure;
};

static void set_whole(unsigned char *record, size_t offset, int64_t value) {
    memcpy(record + offset, &value, sizeof value);
}

static double *numbers(unsigned char *record, size_t offset) {
    return (double *)(void *)(record + offset);
}

static unsigned char *table(unsigned char *record, size_t slot) {
    return record + whole(record, 8 * slot);
}

/* --- Files ---------------------------------------------------------------------------------- */

static uint32_t checksum(const unsigned char *bytes, size_t count) { /* CRC-32 as of zlib */
    uint32_t sum = 0xFFFFFFFFu;
    for (size_t i = 0; i < count; i++) {
        sum ^= bytes[i];
        for (int bit = 0; bit < 8; bit++) sum = (sum >> 1) ^ (0xEDB88320u & (0u - (sum & 1u)));
    }
    return ~sum;
}

static int check(const unsigned char *file, size_t size) {
    uint32_t version, sum;
    if (size < OSC_FILE_HEAD + 4 || memcmp(file, OSC_FILE_MAGIC, 8) != 0) return OSC_NOT_A_CONTROLLER;
    memcpy(&version, file + 8, 4);
    if (version != OSC_FILE_VERSION) return OSC_OTHER_FORMAT;
    memcpy(&sum, file + size - 4, 4);
    if (sum != checksum(file, size - 4)) return OSC_DAMAGED;
    if (memcmp(file + 16, OSC_LAW, 64) != 0) return OSC_OTHER_LAW;
    return OSC_DONE;
}

static size_t line_end(size_t at) { return (at + 63) / 64 * 64; }

static size_t size_of(const unsigned char *bytes, int given) {
    return given < 0 ? (size_t)whole(bytes, 8 * (size_t)(-1 - given)) : (size_t)given;
}

/* Bytes of a record, from its layout; 0 where tables are not where their sizes put them. */
static size_t record_bytes(int record, const unsigned char *bytes, size_t most) {
    size_t end = HEADS[record], slot = 0;
    if (end > most) return 0;
    for (size_t i = 0; i < sizeof TABLES / sizeof *TABLES; i++) {
        if (TABLES[i].record != record) continue;
        size_t rows = size_of(bytes, TABLES[i].rows), columns = size_of(bytes, TABLES[i].columns);
        size_t start = line_end(end);
        if (rows > most || columns > most || (size_t)whole(bytes, 8 * slot++) != start) return 0;
        if (rows > 0 && columns > (most - end) / rows) return 0;
        end = start + TABLES[i].bytes * rows * columns;
        if (end > most) return 0;
    }
    return line_end(end) <= most ? line_end(end) : 0;
}

/* Whether records are where JOB places them, one behind the other, and agree on their sizes. */
static int is_whole(const osc_controller *c) {
    static const size_t places[] = {0, JOB_model, JOB_memory, JOB_work, JOB_input};
    const unsigned char *at[RECORDS];
    size_t sizes[RECORDS], end = 0;
    for (int record = JOB; record < RECORDS; record++) {
        int apart = record == PROGRAM;
        size_t most = apart ? c->program_bytes : c->raw_bytes - end;
        at[record] = apart ? c->program : c->raw + end;
        if (record > JOB && !apart && (size_t)whole(c->raw, places[record]) != end) return 0;
        if ((sizes[record] = record_bytes(record, at[record], most)) == 0) return 0;
        end += apart ? 0 : sizes[record];
    }
    for (size_t i = 0; i < sizeof COUNTS / sizeof *COUNTS; i++)
        if (whole(at[COUNTS[i].record], 8 * (size_t)COUNTS[i].slot) != whole(at[MODEL], COUNTS[i].field))
            return 0;
    return end == c->raw_bytes && sizes[PROGRAM] == c->program_bytes &&
           (size_t)whole(at[MODEL], MODEL_row_bytes) == sizes[MODEL] &&
           (size_t)whole(at[MODEL], MODEL_memory_bytes) == sizes[MEMORY];
}

static int numbers_in_range(const unsigned char *record, const struct number_range *one) {
    const unsigned char *at = one->slot < 0 ? record : record_table(record, (size_t)one->slot);
    size_t rows = size_of(record, one->rows) * size_of(record, one->columns);
    for (size_t row = 0; row < rows; row++, at += one->step)
        for (size_t i = 0; i < one->count; i++) {
            double x = number(at, one->offset + 8 * i);
            if (!(x >= one->low && x <= one->high)) return 0; /* nor if it is NaN */
        }
    return 1;
}

/* Whether MEMORY holds what may be remembered: a file's, or one of a recording. */
static int memory_in_range(const unsigned char *memory, const unsigned char *model) {
    size_t ranges = sizeof MEMORY_NUMBERS / sizeof *MEMORY_NUMBERS;
    const unsigned char *joint = record_table(model, MODEL_joints);
    const unsigned char *torques = record_table(memory, MEMORY_torques);
    if (!MEMORY_in_range(memory, model)) return 0;
    for (size_t i = 0; i < ranges; i++)
        if (!numbers_in_range(memory, &MEMORY_NUMBERS[i])) return 0;
    for (int64_t j = 0; j < whole(model, MODEL_n_joints); j++, joint += JOINT_BYTES) {
        int64_t motor = whole(joint, JOINT_MOTOR);
        if (motor >= 0 && !(fabs(number(torques, 8 * (size_t)motor)) <= number(joint, JOINT_TAU_MAX)))
            return 0;
    }
    return 1;
}

/* Whether all numbers are what the compiled law may use without looking at them. */
static int in_range(const osc_controller *c) {
    size_t ranges = sizeof MODEL_NUMBERS / sizeof *MODEL_NUMBERS;
    const unsigned char *joint = record_table(c->model, MODEL_joints);
    const unsigned char *input = c->raw + whole(c->raw, JOB_input);
    if (!JOB_in_range(c->raw, c->model) || !MODEL_in_range(c->model, c->model)) return 0;
    for (size_t i = 0; i < ranges; i++)
        if (!numbers_in_range(c->model, &MODEL_NUMBERS[i])) return 0;
    for (int64_t j = 0; j < whole(c->model, MODEL_n_joints); j++, joint += JOINT_BYTES)
        if (whole(joint, JOINT_MOTOR) >= 0 && !(number(joint, JOINT_TAU_MAX) > 0.0)) return 0;
    return memory_in_range(c->memory, c->model) && WORK_in_range(c->work, c->model) &&
           INPUT_in_range(input, c->model) && PROGRAM_in_range(c->program, c->model);
}

static void look(osc_controller *c) {
    osc_dimensions *n = &c->dimensions;
    c->job = (int64_t *)(void *)c->raw;
    c->model = c->raw + whole(c->raw, JOB_model);
    c->memory = c->raw + whole(c->raw, JOB_memory);
    c->work = c->raw + whole(c->raw, JOB_work);
    n->joints = (size_t)whole(c->model, MODEL_n_joints);
    n->arms = (size_t)whole(c->model, MODEL_n_arms);
    n->motors = (size_t)whole(c->model, MODEL_n_motors);
    n->contacts = (size_t)whole(c->model, MODEL_n_contacts);
    n->forces = (size_t)whole(c->model, MODEL_n_columns);
    n->bars = (size_t)whole(c->model, MODEL_n_bars);
    n->period = *numbers(c->model, MODEL_period);
}

int osc_create_from(const void *data, size_t size, osc_controller **out) {
    const unsigned char *file = data;
    uint64_t raw_bytes, program_bytes;
    osc_controller *c;
    int code;
    if (out == NULL) return OSC_NULL;
    *out = NULL;
    if (file == NULL) return OSC_NULL;
    if ((code = check(file, size)) != OSC_DONE) return code;
    memcpy(&raw_bytes, file + 80, 8);
    memcpy(&program_bytes, file + 88, 8);
    if (raw_bytes > size || program_bytes > size || raw_bytes % 64 || program_bytes % 64 ||
        raw_bytes + program_bytes + OSC_FILE_HEAD + 4 != size)
        return OSC_DAMAGED;
    if ((c = calloc(1, sizeof *c)) == NULL) return OSC_NO_MEMORY;
    c->raw_bytes = (size_t)raw_bytes;
    c->program_bytes = (size_t)program_bytes;
    c->arena_bytes = 16 * c->program_bytes + (1 << 16);
    c->raw = aligned_alloc(64, (c->raw_bytes + 63) / 64 * 64);
    c->program = aligned_alloc(64, (c->program_bytes + 63) / 64 * 64);
    c->arena = malloc(c->arena_bytes);
    if (c->raw == NULL || c->program == NULL || c->arena == NULL) {
        osc_destroy(c);
        return OSC_NO_MEMORY;
    }
    memcpy(c->raw, file + OSC_FILE_HEAD, c->raw_bytes);
    memcpy(c->program, file + OSC_FILE_HEAD + c->raw_bytes, c->program_bytes);
    if (!is_whole(c)) {
        osc_destroy(c);
        return OSC_DAMAGED;
    }
    look(c);
    if (!in_range(c)) {
        osc_destroy(c);
        return OSC_OUT_OF_RANGE;
    }
    size_t most = 16 + c->dimensions.joints + 6 * c->dimensions.arms + c->dimensions.forces;
    if ((c->missing = malloc(most * sizeof(double))) == NULL) {
        osc_destroy(c);
        return OSC_NO_MEMORY;
    }
    for (size_t i = 0; i < most; i++) c->missing[i] = NAN;
    *out = c;
    return OSC_DONE;
}

int osc_create(const char *path, osc_controller **out) {
    FILE *stream;
    long size = -1;
    unsigned char *file;
    int code = OSC_NO_FILE;
    if (out == NULL) return OSC_NULL;
    *out = NULL;
    if (path == NULL) return OSC_NULL;
    if ((stream = fopen(path, "rb")) == NULL) return OSC_NO_FILE;
    if (fseek(stream, 0, SEEK_END) == 0) size = ftell(stream);
    if (size >= 0 && size < (1L << 30) && fseek(stream, 0, SEEK_SET) == 0) {
        if ((file = malloc((size_t)size + 1)) == NULL) code = OSC_NO_MEMORY;
        else if (fread(file, 1, (size_t)size, stream) == (size_t)size)
            code = osc_create_from(file, (size_t)size, out);
        free(file);
    }
    fclose(stream);
    return code;
}

void osc_destroy(osc_controller *c) {
    if (c == NULL) return;
    free(c->raw);
    free(c->program);
    free(c->arena);
    free(c->missing);
    free(c);
}

int osc_get_dimensions(const osc_controller *c, osc_dimensions *out) {
    if (c == NULL || out == NULL) return OSC_NULL;
    *out = c->dimensions;
    return OSC_DONE;
}

/* --- A tick --------------------------------------------------------------------------------- */

static int fits(osc_numbers x, size_t count) {
    if (x.data == NULL && count > 0) return x.count == count ? OSC_NULL : OSC_WRONG_SIZE;
    if (x.count != count) return OSC_WRONG_SIZE;
    return (uintptr_t)x.data % sizeof(double) == 0 ? OSC_DONE : OSC_UNALIGNED;
}

static int fits_all(const osc_dimensions *n, const osc_measurement *m, const osc_reference *r) {
    int codes[] = {
        fits(m->q, n->joints),          fits(m->v, n->joints),
        fits(m->wrenches, 6 * n->arms), m->touched.count ? fits(m->touched, 28 * n->contacts) : 0,
        fits(r->X_WD, 16),              fits(r->V_D, 6),
        fits(r->A_D, 6),                r->alpha_d.count ? fits(r->alpha_d, n->forces) : 0,
        r->squeeze_d.count ? fits(r->squeeze_d, n->bars) : 0,
        r->active.count ? fits(r->active, n->contacts) : 0,
    };
    for (size_t i = 0; i < sizeof codes / sizeof *codes; i++)
        if (codes[i] != OSC_DONE) return codes[i];
    return OSC_DONE;
}

static void run(osc_controller *c, const osc_measurement *m, const osc_reference *r, const double *w,
                int64_t switches, int64_t begin) {
    int64_t done;
    void *unused;
    const osc_dimensions *n = &c->dimensions;
    const double *alpha = r->alpha_d.count ? r->alpha_d.data : c->missing;
    const uint64_t given[] = {address(m->q.data),    address(m->v.data),   address(w),
                              address(r->X_WD.data), address(r->V_D.data), address(r->A_D.data),
                              address(alpha),        address(m->touched.data),
                              address(r->active.data)};
    const int64_t sizes[] = {(int64_t)n->joints, (int64_t)n->joints, (int64_t)n->arms, 4, 6, 6,
                             (int64_t)n->forces, switches & MOVING ? (int64_t)n->contacts : 0,
                             (int64_t)r->active.count};
    set_whole(c->raw, JOB_switches, switches);
    set_whole(c->raw, JOB_begin, begin);
    osc_law_rows(&done, &unused, address(c->raw), 0, address(given), address(sizes));
    set_whole(c->raw, JOB_switches, 0);
    set_whole(c->raw, JOB_begin, LOOK);
}

/* A tick in one run; in two, where another law writes the command between them. */
static void compute(osc_controller *c, const osc_measurement *m, const osc_reference *r, int64_t switches) {
    if (c->structure == NULL) {
        run(c, m, r, m->wrenches.data, switches, LOOK);
        return;
    }
    set_whole(c->raw, JOB_stop, ALLOCATE);
    run(c, m, r, m->wrenches.data, switches, LOOK);
    set_whole(c->raw, JOB_stop, END);
    if (whole(c->memory, MEMORY_status) == OSC_STATUS_HELD) return;
    c->structure(c, c->of_structure);
    run(c, m, r, m->wrenches.data, switches, ALLOCATE);
}

/* Torques within the limits; returns whether they were found. */
static int relieve(osc_controller *c) {
    int64_t k, ready;
    void *unused;
    uint64_t raw = address(c->raw), program = address(c->program);
    unsigned char *p = c->program;
    int n = (int)c->dimensions.motors;
    osc_law_fill(&k, &unused, raw, 0, 0, program);
    for (int pass = 0; pass < 2; pass++) {
        int64_t slack = pass ? k : 0;
        osc_law_prepare(&ready, &unused, program, slack);
        if (!ready) return 0;
        if (osc_solve(n + (int)slack, (int)k, numbers(table(p, PROGRAM_H), 0),
                      numbers(table(p, PROGRAM_f), 0), numbers(table(p, PROGRAM_A), 0),
                      numbers(table(p, PROGRAM_upper), 0), numbers(table(p, PROGRAM_lower), 0),
                      (int *)(void *)table(p, PROGRAM_sense), numbers(table(p, PROGRAM_z), 0),
                      numbers(table(p, PROGRAM_lam), 0), c->arena, c->arena_bytes) <= 0)
            continue;
        osc_law_finish(&ready, &unused, program, slack);
        if (ready) {
            osc_law_settle(&ready, &unused, raw, 0, 0, program);
            return 1;
        }
    }
    return 0;
}

int osc_tick(osc_controller *c, const osc_measurement *m, const osc_reference *r, osc_command *out) {
    int code;
    int64_t switches = 0;
    if (c == NULL || m == NULL || r == NULL || out == NULL || out->torques == NULL) return OSC_NULL;
    if ((uintptr_t)out->torques % sizeof(double) != 0) return OSC_UNALIGNED;
    if (out->count != c->dimensions.motors) return OSC_WRONG_SIZE;
    if ((code = fits_all(&c->dimensions, m, r)) != OSC_DONE) return code;
    double *squeeze = numbers(table(c->memory, MEMORY_squeeze), 0);
    size_t squeezes = c->dimensions.bars > 1 ? c->dimensions.bars : 1;
    for (size_t i = 0; i < squeezes; i++)
        squeeze[i] = r->squeeze_d.count ? r->squeeze_d.data[i] : 0.0;
    if (c->dimensions.arms > 2 && r->squeeze_d.count) switches |= COMMANDED;
    if (m->touched.count) switches |= MOVING;
    if (m->repeated) set_whole(c->memory, MEMORY_repeated, m->repeated);
    if (m->estimated) set_whole(c->memory, MEMORY_derived, m->estimated == NOISY ? NOISY : 1);
    if (m->wrench_missing) set_whole(c->memory, MEMORY_wrench_missing, 1);
    if (m->wrench_age >= 0) {
        if (!whole(c->memory, MEMORY_stamped))
            set_whole(c->memory, MEMORY_stamped, whole(c->memory, MEMORY_instant) + 1);
        set_whole(c->memory, MEMORY_late, m->wrench_age < HISTORY ? m->wrench_age : HISTORY);
    }
    compute(c, m, r, switches);
    if (whole(c->memory, MEMORY_status) == OSC_STATUS_SATURATED && !relieve(c)) {
        osc_reference none = *r;
        none.X_WD.data = c->missing; /* so that the tick counts as not computed */
        run(c, m, &none, c->missing, 0, LOOK);
    }
    memcpy(out->torques, table(c->memory, MEMORY_torques), c->dimensions.motors * sizeof(double));
    out->status = (int32_t)whole(c->memory, MEMORY_status);
    out->reason = (int32_t)whole(c->memory, MEMORY_reason);
    out->state = (int32_t)whole(c->memory, MEMORY_state);
    int stopped = out->state == OSC_STATE_SAFE_STOP;
    out->unbraked = stopped ? (int32_t)whole(c->memory, MEMORY_unbraked) : -1;
    out->cause = stopped ? (int32_t)whole(c->memory, MEMORY_cause) : OSC_REASON_NO_REASON;
    out->culprit = stopped ? (int32_t)whole(c->memory, MEMORY_culprit) : -1;
    return OSC_DONE;
}

/* --- Settings ------------------------------------------------------------------------------- */

int osc_reset(osc_controller *c) {
    if (c == NULL) return OSC_NULL;
    set_whole(c->memory, MEMORY_state, OSC_STATE_RUN);
    for (size_t i = 0; i < sizeof FORGOTTEN / sizeof *FORGOTTEN; i++) {
        const struct forgotten *one = &FORGOTTEN[i];
        unsigned char *at = one->slot < 0 ? c->memory : table(c->memory, (size_t)one->slot);
        size_t rows = one->slot < 0 ? 1 : (size_t)whole(c->memory, 8 * (size_t)one->count);
        for (size_t row = 0; row < rows; row++)
            memset(at + row * one->step + one->offset, 0, one->bytes);
    }
    return OSC_DONE;
}

int osc_set_tare(osc_controller *c, const double wrench[6]) {
    if (c == NULL || wrench == NULL) return OSC_NULL;
    for (int i = 0; i < 6; i++)
        if (!isfinite(wrench[i])) return OSC_OUT_OF_RANGE;
    memcpy(c->memory + MEMORY_f_tare, wrench, 6 * sizeof(double));
    return OSC_DONE;
}

int osc_get_tare(const osc_controller *c, double wrench[6]) {
    if (c == NULL || wrench == NULL) return OSC_NULL;
    memcpy(wrench, c->memory + MEMORY_f_tare, 6 * sizeof(double));
    return OSC_DONE;
}

/* The command of the motion integral becomes a constant wrench. */
static void hand_over(osc_controller *c) {
    osc_numbers none = {c->missing, 0};
    osc_measurement m = {none, none, none, {NULL, 0}, 0, 0, 0, -1};
    osc_reference r = {none, none, none, none, none, none};
    run(c, &m, &r, c->missing, 0, HAND_OVER);
}

/* The command of the motion integral stays: ∫e is scaled, or handed over. */
static void keep_integral(osc_controller *c, double before, double after) {
    double *sum = numbers(c->memory, MEMORY_motion_sum);
    if (after > 0.0) {
        for (int i = 0; i < 6; i++) sum[i] *= before / after;
    } else if (whole(c->memory, MEMORY_ticked)) {
        hand_over(c);
    }
}

int osc_set_gain(osc_controller *c, const char *name, double value) {
    if (c == NULL || name == NULL) return OSC_NULL;
    if (!(value >= 0.0) || !isfinite(value)) return OSC_OUT_OF_RANGE;
    for (size_t i = 0; i < sizeof GAINS / sizeof *GAINS; i++) {
        const struct gain *gain = &GAINS[i];
        if (strcmp(name, gain->name) != 0) continue;
        double *field = numbers(c->model, gain->offset);
        if (gain->offset == MODEL_integral && *field != value) {
            keep_integral(c, *field, value);
        }
        *field = value;
        if (gain->of_contact >= 0 && whole(c->model, MODEL_phased) == 0) {
            unsigned char *contacts = table(c->memory, MEMORY_contacts);
            for (size_t k = 0; k < c->dimensions.contacts; k++)
                memcpy(contacts + k * MEMORY_contacts_BYTES + gain->of_contact, &value, sizeof value);
        }
        return OSC_DONE;
    }
    return OSC_UNKNOWN_NAME;
}

/* --- For recordings ------------------------------------------------------------------------- */

int osc_get_memory(const osc_controller *c, void *out, size_t size) {
    if (c == NULL || out == NULL) return OSC_NULL;
    if (size != (size_t)whole(c->model, MODEL_memory_bytes)) return OSC_WRONG_SIZE;
    memcpy(out, c->memory, size);
    return OSC_DONE;
}

int osc_set_memory(osc_controller *c, const void *bytes, size_t size) {
    if (c == NULL || bytes == NULL) return OSC_NULL;
    if (size != (size_t)whole(c->model, MODEL_memory_bytes)) return OSC_WRONG_SIZE;
    size_t layout = 8 * MEMORY_LAYOUT_WORDS;
    if (memcmp(c->memory, bytes, layout) != 0) return OSC_WRONG_SIZE; /* of another structure */
    if (!memory_in_range(bytes, c->model)) return OSC_OUT_OF_RANGE;
    memcpy(c->memory, bytes, size);
    return OSC_DONE;
}

const char *osc_error_text(int error) {
    int at = -error;
    return at >= 0 && at < (int)(sizeof ERROR_TEXTS / sizeof *ERROR_TEXTS) ? ERROR_TEXTS[at] : "unknown";
}

/* --- What it reports ------------------------------------------------------------------------ */

int osc_get_forces(const osc_controller *c, double *alpha, size_t forces) {
    if (c == NULL || alpha == NULL) return OSC_NULL;
    if (forces != c->dimensions.forces) return OSC_WRONG_SIZE;
    const unsigned char *row = table(c->memory, MEMORY_columns);
    for (size_t j = 0; j < forces; j++, row += MEMORY_columns_BYTES)
        memcpy(alpha + j, row + MEMORY_columns_alpha, sizeof *alpha);
    return OSC_DONE;
}

int osc_get_phases(const osc_controller *c, int32_t *phases, size_t contacts) {
    if (c == NULL || phases == NULL) return OSC_NULL;
    if (contacts != c->dimensions.contacts) return OSC_WRONG_SIZE;
    const unsigned char *row = table(c->memory, MEMORY_contacts);
    for (size_t i = 0; i < contacts; i++, row += MEMORY_contacts_BYTES) {
        int32_t phase = OSC_PHASE_CLOSED;
        if (whole(c->model, MODEL_phased)) phase = (int32_t)whole(row, MEMORY_contacts_phase);
        if (!whole(row, MEMORY_contacts_active)) phase = OSC_PHASE_OPEN;
        memcpy(phases + i, &phase, sizeof phase);
    }
    return OSC_DONE;
}

int osc_get_active(const osc_controller *c, int32_t *active, size_t contacts) {
    if (c == NULL || active == NULL) return OSC_NULL;
    if (contacts != c->dimensions.contacts) return OSC_WRONG_SIZE;
    const unsigned char *row = table(c->memory, MEMORY_contacts);
    for (size_t i = 0; i < contacts; i++, row += MEMORY_contacts_BYTES)
        active[i] = whole(row, MEMORY_contacts_active) != 0;
    return OSC_DONE;
}

int osc_get_motion_integral(const osc_controller *c, double integral[6]) {
    if (c == NULL || integral == NULL) return OSC_NULL;
    memcpy(integral, c->memory + MEMORY_motion_sum, 6 * sizeof(double));
    return OSC_DONE;
}

int osc_get_force_integral(const osc_controller *c, double integral[6], size_t *count) {
    if (c == NULL || integral == NULL || count == NULL) return OSC_NULL;
    int64_t rank = whole(c->memory, MEMORY_force_rank);
    *count = rank < 0 ? 0 : rank > 6 ? 6 : (size_t)rank;
    memcpy(integral, c->memory + MEMORY_force_sum, *count * sizeof(double));
    return OSC_DONE;
}

int osc_get_friction(const osc_controller *c, double *friction, size_t count) {
    if (c == NULL || friction == NULL) return OSC_NULL;
    if (count != 2 * c->dimensions.joints) return OSC_WRONG_SIZE;
    const unsigned char *known = table(c->memory, MEMORY_friction_known);
    const unsigned char *learned = table(c->memory, MEMORY_friction) + MEMORY_friction_theta;
    const unsigned char *given = table(c->model, MODEL_joints) + MODEL_joints_theta;
    for (size_t j = 0; j < c->dimensions.joints; j++) {
        const unsigned char *from =
            whole(known, 8 * j) ? learned + j * MEMORY_friction_BYTES : given + j * MODEL_joints_BYTES;
        memcpy(friction + 2 * j, from, 2 * sizeof(double));
    }
    return OSC_DONE;
}

const char *osc_reason_text(int reason) {
    for (size_t i = 0; i < sizeof REASON_TEXTS / sizeof *REASON_TEXTS; i++)
        if (REASON_TEXTS[i].reason == reason) return REASON_TEXTS[i].text;
    return "unknown";
}

/* --- Contacts ------------------------------------------------------------------------------- */

int osc_engage(osc_controller *c) {
    if (c == NULL) return OSC_NULL;
    if (whole(c->memory, MEMORY_engaged)) return OSC_DONE;
    if (!whole(c->memory, MEMORY_ticked)) return OSC_NO_TICK;
    hand_over(c);
    set_whole(c->memory, MEMORY_force_rank, 0);
    set_whole(c->memory, MEMORY_by_column, 0);
    unsigned char *column = table(c->memory, MEMORY_columns);
    for (size_t j = 0; j < c->dimensions.forces; j++, column += MEMORY_columns_BYTES)
        memset(column + MEMORY_columns_integral, 0, sizeof(double));
    set_whole(c->memory, MEMORY_engaged, 1);
    if (!whole(c->model, MODEL_phased)) {
        unsigned char *row = table(c->memory, MEMORY_contacts);
        for (size_t i = 0; i < c->dimensions.contacts; i++, row += MEMORY_contacts_BYTES)
            set_whole(row, MEMORY_contacts_active, 1);
    }
    return OSC_DONE;
}

static int find_phase_setting(const osc_controller *c, const char *name,
                              const struct phase_setting **found) {
    if (!whole(c->model, MODEL_phased)) return OSC_NO_PHASES;
    for (size_t i = 0; i < sizeof PHASE_SETTINGS / sizeof *PHASE_SETTINGS; i++)
        if (strcmp(name, PHASE_SETTINGS[i].name) == 0) {
            *found = &PHASE_SETTINGS[i];
            return OSC_DONE;
        }
    return OSC_UNKNOWN_NAME;
}

int osc_get_phase_setting(const osc_controller *c, const char *name, double *value) {
    const struct phase_setting *one;
    int code;
    if (c == NULL || name == NULL || value == NULL) return OSC_NULL;
    if ((code = find_phase_setting(c, name, &one)) != OSC_DONE) return code;
    memcpy(value, c->model + one->offset, sizeof *value);
    return OSC_DONE;
}

/* What cannot work is refused: an approach that pushes less than counts as contact, for one. */
int osc_set_phase_setting(osc_controller *c, const char *name, double value) {
    const struct phase_setting *one;
    int code;
    if (c == NULL || name == NULL) return OSC_NULL;
    if ((code = find_phase_setting(c, name, &one)) != OSC_DONE) return code;
    if (!isfinite(value) || !(one->may_be_zero ? value >= 0.0 : value > 0.0)) return OSC_OUT_OF_RANGE;
    double *field = numbers(c->model, one->offset), before = *field;
    *field = value;
    double on = *numbers(c->model, MODEL_force_on);
    double push = *numbers(c->model, MODEL_approach_damping) * *numbers(c->model, MODEL_approach_speed);
    if (push > on && on > *numbers(c->model, MODEL_force_off)) return OSC_DONE;
    *field = before;
    return OSC_OUT_OF_RANGE;
}
