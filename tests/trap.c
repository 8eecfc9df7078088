/* Linked with --wrap around a program: a tick that allocates or frees memory ends it. */
#include "osc_controller.h"

#include <stdlib.h>

static _Thread_local int ticking;

static void require_no_tick(void) {
    if (ticking) abort();
}

void *__real_malloc(size_t bytes);
void *__real_calloc(size_t count, size_t bytes);
void *__real_realloc(void *old, size_t bytes);
void *__real_aligned_alloc(size_t alignment, size_t bytes);
void __real_free(void *at);
int __real_osc_tick(osc_controller *c, const osc_measurement *m, const osc_reference *r,
                    osc_command *out);

void *__wrap_malloc(size_t bytes) {
    require_no_tick();
    return __real_malloc(bytes);
}

void *__wrap_calloc(size_t count, size_t bytes) {
    require_no_tick();
    return __real_calloc(count, bytes);
}

void *__wrap_realloc(void *old, size_t bytes) {
    require_no_tick();
    return __real_realloc(old, bytes);
}

void *__wrap_aligned_alloc(size_t alignment, size_t bytes) {
    require_no_tick();
    return __real_aligned_alloc(alignment, bytes);
}

void __wrap_free(void *at) {
    require_no_tick();
    __real_free(at);
}

int __wrap_osc_tick(osc_controller *c, const osc_measurement *m, const osc_reference *r,
                    osc_command *out) {
    ticking = 1;
#ifdef RED
    void *volatile at = malloc(out->count);
    free(at);
#endif
    int code = __real_osc_tick(c, m, r, out);
    ticking = 0;
    return code;
}
