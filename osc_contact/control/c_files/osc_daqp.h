/* The quadratic programs of ticks beyond the motors' limits, solved by daqp (daqp/LICENSE). */
#ifndef OSC_DAQP_H
#define OSC_DAQP_H
#include <stddef.h>

/* min ½zᵀHz + fᵀz with lower ≤ (z, Az) ≤ upper; n numbers z, k rows of A. Returns daqp's verdict,
 * or −100 where the arena is too small. Nothing is allocated beside the arena. */
int osc_solve(int n, int k, double *H, double *f, double *A, double *upper, double *lower, int *sense,
              double *z, double *lam, void *arena, size_t bytes);
#endif
