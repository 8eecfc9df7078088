/* A selection law in the place of motion filter and control structure: pages compare with it. */
#ifndef OSC_SELECTION_H
#define OSC_SELECTION_H
#include "osc_controller.h"

enum { OSC_AXES = 6 };

/* Axes of the world through one point along or about which wrenches are controlled, forces first; they
 * move with the object, but do not turn. point: from the operational point O, in m. */
typedef struct {
    int32_t forces, couples;
    double point[3], axes[OSC_AXES][3];
} osc_selection;

/* From the next tick on the command is F = Λ Ω a + Ω̄ f + μ + p of this selection; null: the controller's
 * own law again. The selection is not copied. */
void osc_select(osc_controller *controller, const osc_selection *selection);
#endif
