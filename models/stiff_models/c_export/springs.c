static const double NONE[6] = {0.0};
static double clipped(double t, double end) { return t > end ? end : t < -end ? -end : t; }

/* Deflection of the point at places[0..2] from the TCP, by a wrench at places[3..5] from there. */
static void bent(const double q[], const double wrench[], const double places[], double d[]) {
    double frame[FRAME], wave[1 + 4 * STIFF_JOINTS] = {1.0}, load[SPRINGS], turn[SPRINGS] = {0.0};
    double arm[3] = {0.0}, lever[3] = {0.0}, moment[3], moved[6] = {0.0};
    int i, k;
    kinematics(q, frame);
    for (i = 0; i < 9; i++) arm[i % 3] += frame[AXES + i] * places[i / 3];
    for (i = 0; i < 9; i++) lever[i % 3] += frame[AXES + i] * (places[i / 3] + places[3 + i / 3]);
    cross(lever, wrench, moment);
    for (k = 0; k < 3; k++) moment[k] += wrench[3 + k];
    for (i = 0; i < SPRINGS; i++)
        load[i] = dot(frame + TWISTS + 6 * i, wrench) + dot(frame + TWISTS + 6 * i + 3, moment);
    for (i = 0; i < 2 * STIFF_JOINTS; i++) { /* cos, sin, cos 2, sin 2 of each joint's angle */
        wave[2 * i + 1] = cos((i % 2 + 1) * q[i / 2]);
        wave[2 * i + 2] = sin((i % 2 + 1) * q[i / 2]);
    }
    for (i = 0; i < LINES; i++) {
        const short *at = LINE_AT + 4 * i; /* turned spring, loaded spring, two waves */
        turn[at[0]] += LINE[i] * wave[at[2]] * wave[at[3]] * load[at[1]];
    }
    for (i = 0; i < CURVES; i++) {
        const short *at = CURVE_AT + 3 * i; /* spring, preloaded by the weights, clips */
        const double from = at[1] ? frame[WEIGHTS + at[0]] : 0.0, to = from + load[at[0]];
        const double w = CURVE[2 * i], height = CURVE[2 * i + 1];
        turn[at[0]] += at[2] ? height * (clipped(to, w) - clipped(from, w))
                             : height * (atan(to / w) - atan(from / w));
    }
    for (i = 0; i < 6 * SPRINGS; i++) moved[i % 6] += frame[TWISTS + i] * turn[i / 6];
    cross(moved + 3, arm, d);
    for (k = 0; k < 3; k++) d[k] += moved[k];
}

void deflection(const double q[], const double wrench[], double d[]) { bent(q, wrench, POINT, d); }
#define at_tcp(q, wrench, d) bent(q, wrench, NONE, d)
