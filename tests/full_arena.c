/* A problem of one unknown, in arenas from none to one that is large enough. */
#include "osc_daqp.h"
#include <stdio.h>
#include <stdlib.h>

int main(void) {
    double H[1] = {1.0}, f[1] = {-2.0}, upper[1] = {1.0}, lower[1] = {-1.0}, z[1], lam[1];
    int sense[1] = {0}, full = 0, solved = 0;
    for (size_t bytes = 64; bytes <= 1 << 16; bytes *= 2) {
        void *memory = malloc(bytes);
        z[0] = 0.0;
        int flag = osc_solve(1, 0, H, f, NULL, upper, lower, sense, z, lam, memory, bytes);
        if (flag == -100) full++;
        else if (flag == 1 && z[0] == 1.0) solved++;
        free(memory);
    }
    printf("%d full, %d solved\n", full, solved);
    return 0;
}
