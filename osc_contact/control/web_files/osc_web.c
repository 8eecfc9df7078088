/* The controller of osc_controller.h for WebAssembly: one block of arrays per controller, ticks
 * without arguments, and the filter that shapes set points which jump. Addresses are offsets into the
 * module's memory; every function is one of its exports.
 */
#include "osc_selection.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define EXPORT(name) __attribute__((export_name(#name))) name

/* Arrays that a program around the module fills before a tick, then reads; osc_web_array. */
enum array { Q, V, WRENCHES, X_WD, V_D, A_D, ALPHA_D, SQUEEZE_D, ACTIVE, TOUCHED, TORQUES, FORCES, ARRAYS };
/* What came with a tick; osc_web_input. */
enum input { SQUEEZED, SWITCHED, TOUCHING, WRENCH_MISSING, REPEATED, ESTIMATED, WRENCH_AGE, INPUTS };
/* How a tick ended; osc_web_result. */
enum result { STATUS, REASON, STATE, CAUSE, CULPRIT, UNBRAKED, RESULTS };

typedef struct {
    osc_controller *controller;
    osc_dimensions dimensions;
    double *arrays[ARRAYS];
    size_t counts[ARRAYS];
    int32_t inputs[INPUTS], results[RESULTS];
    osc_selection selection;
} osc_web;

/* Of numba: called where an array's memory is given back. The law's arrays own none, so it is never
 * called; of code that is not optimised before it is linked, the call remains. */
void NRT_MemInfo_call_dtor(void *memory) {
    (void)memory;
    abort();
}

void *EXPORT(osc_web_take)(size_t bytes) { return malloc(bytes); }

void EXPORT(osc_web_give_back)(void *memory) { free(memory); }

void EXPORT(osc_web_close)(osc_web *w) {
    if (w == NULL) return;
    for (int i = 0; i < ARRAYS; i++) free(w->arrays[i]);
    osc_destroy(w->controller);
    free(w);
}

/* A controller out of the content of a file; null with one of enum osc_error where it is refused. */
osc_web *EXPORT(osc_web_open)(const void *file, size_t bytes, int32_t *error) {
    osc_web *w = calloc(1, sizeof *w);
    *error = OSC_NO_MEMORY;
    if (w == NULL) return NULL;
    if ((*error = osc_create_from(file, bytes, &w->controller)) != OSC_DONE) {
        free(w);
        return NULL;
    }
    osc_get_dimensions(w->controller, &w->dimensions);
    const osc_dimensions *n = &w->dimensions;
    const size_t counts[ARRAYS] = {
        [Q] = n->joints,        [V] = n->joints,      [WRENCHES] = 6 * n->arms,
        [X_WD] = 16,            [V_D] = 6,            [A_D] = 6,
        [ALPHA_D] = n->forces,  [SQUEEZE_D] = n->bars, [ACTIVE] = n->contacts, [TOUCHED] = 28 * n->contacts,
        [TORQUES] = n->motors,  [FORCES] = n->forces,
    };
    memcpy(w->counts, counts, sizeof counts);
    w->inputs[WRENCH_AGE] = -1;
    for (int i = 0; i < ARRAYS; i++)
        if ((w->arrays[i] = calloc(counts[i] + 1, sizeof(double))) == NULL) {
            osc_web_close(w);
            *error = OSC_NO_MEMORY;
            return NULL;
        }
    return w;
}

double *EXPORT(osc_web_array)(osc_web *w, int array) { return w->arrays[array]; }

size_t EXPORT(osc_web_count)(osc_web *w, int array) { return w->counts[array]; }

int32_t *EXPORT(osc_web_input)(osc_web *w) { return w->inputs; }

int32_t *EXPORT(osc_web_result)(osc_web *w) { return w->results; }

double EXPORT(osc_web_period)(osc_web *w) { return w->dimensions.period; }

/* One tick of the arrays; one of enum osc_error. */
int32_t EXPORT(osc_web_tick)(osc_web *w) {
#define GIVEN(array, is_there) {w->arrays[array], (is_there) ? w->counts[array] : 0}
    const int32_t *in = w->inputs;
    osc_measurement m = {GIVEN(Q, 1), GIVEN(V, 1), GIVEN(WRENCHES, 1), GIVEN(TOUCHED, in[TOUCHING])};
    m.wrench_missing = in[WRENCH_MISSING];
    m.repeated = in[REPEATED];
    m.estimated = in[ESTIMATED];
    m.wrench_age = in[WRENCH_AGE];
    osc_reference r = {GIVEN(X_WD, 1), GIVEN(V_D, 1), GIVEN(A_D, 1), GIVEN(ALPHA_D, 1),
                       GIVEN(SQUEEZE_D, in[SQUEEZED]), GIVEN(ACTIVE, in[SWITCHED])};
    osc_command out = {.torques = w->arrays[TORQUES], .count = w->counts[TORQUES]};
    int32_t code = osc_tick(w->controller, &m, &r, &out);
    if (code != OSC_DONE) return code;
    w->results[STATUS] = out.status;
    w->results[REASON] = out.reason;
    w->results[STATE] = out.state;
    w->results[CAUSE] = out.cause;
    w->results[CULPRIT] = out.culprit;
    w->results[UNBRAKED] = out.unbraked;
    return osc_get_forces(w->controller, w->arrays[FORCES], w->counts[FORCES]);
}

int32_t EXPORT(osc_web_reset)(osc_web *w) { return osc_reset(w->controller); }

int32_t EXPORT(osc_web_set_memory)(osc_web *w, const void *memory, size_t bytes) {
    return osc_set_memory(w->controller, memory, bytes);
}

/* Another law for the next ticks. numbers: the point and the axes of osc_selection, one behind the other. */
int32_t EXPORT(osc_web_select)(osc_web *w, int32_t forces, int32_t couples, const double *numbers) {
    if (forces < 0 || couples < 0 || forces + couples > OSC_AXES) return OSC_WRONG_SIZE;
    w->selection.forces = forces;
    w->selection.couples = couples;
    memcpy(w->selection.point, numbers, 3 * sizeof(double));
    memcpy(w->selection.axes, numbers + 3, 3 * (size_t)(forces + couples) * sizeof(double));
    osc_select(w->controller, &w->selection);
    return OSC_DONE;
}

/* Hash of the sources of the law; by it Python finds out whether a module is of its own law. */
const char *EXPORT(osc_web_law)(void) { return OSC_LAW; }

const char *EXPORT(osc_web_error_text)(int32_t error) { return osc_error_text(error); }

const char *EXPORT(osc_web_reason_text)(int32_t reason) { return osc_reason_text(reason); }

/* Moves value, rate and second derivative of a set point by one period towards what is wanted: a lag of
 * third order with one triple pole, solved exactly, so that none of the three jumps where what is wanted
 * does. pace: of the pole, 1/s. */
void EXPORT(osc_web_shape)(double state[3], double wanted, double pace, double period) {
    double away = state[0] - wanted, t = period, decay = exp(-pace * period);
    double first = state[1] + pace * away; /* away(t) = (away + first t + second t²/2) decay */
    double second = state[2] + 2.0 * pace * state[1] + pace * pace * away;
    double value = away + first * t + 0.5 * second * t * t, slope = first + second * t;
    state[0] = wanted + decay * value;
    state[1] = decay * (slope - pace * value);
    state[2] = decay * (second - 2.0 * pace * slope + pace * pace * value);
}
