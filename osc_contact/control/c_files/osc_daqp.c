/* daqp in memory that was taken before: its malloc takes from an arena that each call begins anew. */
#include "osc_daqp.h"
#include <setjmp.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

static _Thread_local struct {
    unsigned char *next, *end;
    jmp_buf full;
} arena;

static void *take(size_t bytes) {
    unsigned char *at = arena.next;
    bytes = (bytes + 15) / 16 * 16;
    if (bytes > (size_t)(arena.end - at)) longjmp(arena.full, 1);
    arena.next += bytes;
    return at;
}

static void *take_zeros(size_t count, size_t bytes) { return memset(take(count * bytes), 0, count * bytes); }

static void *take_more(void *old, size_t bytes) {
    void *at = take(bytes);
    if (old != NULL) {
        size_t behind = (size_t)((unsigned char *)at - (unsigned char *)old);
        memcpy(at, old, bytes < behind ? bytes : behind);
    }
    return at;
}

#define malloc take
#define calloc take_zeros
#define realloc take_more
#define free(x) ((void)(x))
#include "daqp/src/api.c"
#include "daqp/src/auxiliary.c"
#include "daqp/src/avi.c"
#include "daqp/src/bnb.c"
#include "daqp/src/daqp.c"
#include "daqp/src/daqp_prox.c"
#include "daqp/src/eq_elim.c"
#include "daqp/src/factorization.c"
#include "daqp/src/hierarchical.c"
#include "daqp/src/presolve.c"
#include "daqp/src/utils.c"

int osc_solve(int n, int k, double *H, double *f, double *A, double *upper, double *lower, int *sense,
              double *z, double *lam, void *memory, size_t bytes) {
    DAQPResult result;
    DAQPProblem problem;
    DAQPSettings settings;
    unsigned char *first = (unsigned char *)(((uintptr_t)memory + 15) / 16 * 16);
    arena.next = first;
    arena.end = (unsigned char *)memory + bytes;
    if (setjmp(arena.full)) return -100;
    memset(&result, 0, sizeof result);
    memset(&problem, 0, sizeof problem);
    problem.n = n;
    problem.m = n + k;
    problem.ms = n;
    problem.H = H;
    problem.f = f;
    problem.A = A;
    problem.bupper = upper;
    problem.blower = lower;
    problem.sense = sense;
    daqp_default_settings(&settings);
    settings.primal_tol = 1e-10;
    result.x = z;
    result.lam = lam;
    daqp_quadprog(&result, &problem, &settings);
    return result.exitflag;
}
