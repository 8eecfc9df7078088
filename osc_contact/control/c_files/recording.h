/* A recording of ticks, as `osc-contact build` writes it: for replays and trials without a robot. */
#ifndef RECORDING_H
#define RECORDING_H
#include "osc_controller.h"

typedef struct {
    unsigned char *bytes;
    size_t size, at, memory_bytes;
    int64_t count;
    osc_dimensions n;
} recording;

typedef struct {
    osc_measurement m;
    osc_reference r;
    const void *memory;    /* what the program around the controller changed before the tick, or null */
    const double *torques; /* of the run that was recorded */
    int64_t status;
} recorded_tick;

/* The controller and the recording beside the program, or in the two words from `first` on. Ends the
 * program with a sentence where one cannot be read. */
void open_both(int first, int count, char **words, osc_controller **c, recording *tape);
void rewind_recording(recording *tape);
/* One more tick; its memory, if any, is put into the controller. */
recorded_tick next_tick(recording *tape, osc_controller *c);
/* Ends the program with a sentence where an error is not OSC_DONE. */
void require(int error, const char *what);
void sort(double *x, size_t count);
/* Of sorted numbers: the one that `share` of them do not exceed. */
double quantile(const double *sorted, size_t count, double share);
#endif
