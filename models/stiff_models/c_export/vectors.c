#include <math.h>

/* A frame: TCP, axes of the tool, motions by each spring, weights' torques; in the base's axes. */
enum { SPRINGS = 6 * STIFF_JOINTS + 6, AXES = 3, TWISTS = 12 };
enum { WEIGHTS = TWISTS + 6 * SPRINGS, FRAME = WEIGHTS + SPRINGS };

static double dot(const double a[], const double b[]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double a[], const double b[], double out[]) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}
