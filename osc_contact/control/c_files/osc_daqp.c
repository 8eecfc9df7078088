/* daqp in memory that was taken before: its malloc takes from an arena that each call begins anew.
 *
 * daqp looks at no result of malloc. Where the arena is full, which osc_create makes large enough for
 * every problem of the law, it is given memory of the heap, so that it comes to its end; the call then
 * returns an error. */
#include "osc_daqp.h"
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { ARENA_FULL = -100 }; /* beside daqp's own exit flags */

struct block { /* of the heap; what was asked for stands behind it */
    struct block *next;
    size_t unused; /* so that what stands behind it begins at a multiple of 16 bytes */
};

static _Thread_local struct {
    unsigned char *next, *end;
    struct block *blocks; /* taken since the arena was full */
} arena;

static void *take(size_t bytes) {
    unsigned char *at = arena.next;
    bytes = (bytes + 15) / 16 * 16;
    if (bytes <= (size_t)(arena.end - at)) {
        arena.next += bytes;
        return at;
    }
    struct block *block = malloc(16 + bytes);
    if (block == NULL) abort();
    block->next = arena.blocks;
    arena.blocks = block;
    return (unsigned char *)block + 16;
}

/* Whether the arena was full; the heap gets its memory back. */
static int was_full(void) {
    int full = arena.blocks != NULL;
    while (arena.blocks != NULL) {
        struct block *block = arena.blocks;
        arena.blocks = block->next;
        free(block);
    }
    return full;
}

static void *take_zeros(size_t count, size_t bytes) { return memset(take(count * bytes), 0, count * bytes); }

#define malloc take
#define calloc take_zeros
#define realloc daqp_does_not_call_this
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
    return was_full() ? ARENA_FULL : result.exitflag;
}
