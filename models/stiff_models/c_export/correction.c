/* Damped Newton steps from q to the pose of the TCP in a frame; 1 if it is reached. */
static int inverse(const double target[], double q[]) {
    double frame[FRAME], remaining[STEPS], normal[STIFF_JOINTS][STIFF_JOINTS], row[STIFF_JOINTS][6];
    int step, i, j, k;
    for (step = 0; step < STEPS; step++) {
        double error[6] = {0.0}, move[STIFF_JOINTS], product[3];
        double cosine = -0.5, length, largest = LARGEST_TURN;
        kinematics(q, frame);
        for (k = 0; k < 3; k++) {
            error[k] = target[k] - frame[k];
            cross(frame + AXES + 3 * k, target + AXES + 3 * k, product);
            for (i = 0; i < 3; i++) error[3 + i] += 0.5 * product[i];
            cosine += 0.5 * dot(frame + AXES + 3 * k, target + AXES + 3 * k);
        }
        length = sqrt(dot(error + 3, error + 3));
        for (i = 3; i < 6 && length > 0.0; i++) error[i] *= atan2(length, cosine) / length;
        if (sqrt(dot(error, error)) <= REACHED_M && sqrt(dot(error + 3, error + 3)) <= REACHED_RAD)
            return 1;
        for (i = 0; i < 3; i++) error[i] /= LENGTH;
        remaining[step] = sqrt(dot(error, error) + dot(error + 3, error + 3));
        if (step >= PATIENCE && !(remaining[step] < 0.5 * remaining[step - PATIENCE])) return 0;
        for (i = 0; i < STIFF_JOINTS; i++) {
            const double *twist = frame + TWISTS + 6 * OWN[i];
            for (k = 0; k < 6; k++) row[i][k] = twist[k] / (k < 3 ? LENGTH : 1.0);
            move[i] = dot(row[i], error) + dot(row[i] + 3, error + 3);
            for (j = 0; j <= i; j++)
                normal[i][j] = normal[j][i] = dot(row[i], row[j]) + dot(row[i] + 3, row[j] + 3);
            normal[i][i] += 0.5 * remaining[step] * remaining[step] + 1e-14;
        }
        for (i = 0; i < STIFF_JOINTS; i++) /* elimination; the matrix is positive definite */
            for (j = 0; j < STIFF_JOINTS; j++) {
                const double factor = j == i ? 0.0 : normal[j][i] / normal[i][i];
                for (k = i; k < STIFF_JOINTS; k++) normal[j][k] -= factor * normal[i][k];
                move[j] -= factor * move[i];
            }
        for (i = 0; i < STIFF_JOINTS; i++) largest = fmax(largest, fabs(move[i] /= normal[i][i]));
        for (i = 0; i < STIFF_JOINTS; i++) q[i] += move[i] * (LARGEST_TURN / largest);
    }
    return 0;
}

int correct(const double q[], const double wrench[], double command[]) {
    double frame[FRAME], start[STIFF_JOINTS], target[3], off[3], d[3], length = 0.0, before;
    int i, iteration = 0, status = STIFF_JOINTS > 6 ? STIFF_REDUNDANT : 0;
    for (i = 0; i < STIFF_JOINTS; i++) command[i] = start[i] = q[i];
    kinematics(start, frame);
    for (i = 0; i < 3; i++) target[i] = frame[i];
    while (!status) {
        at_tcp(command, wrench, d);
        for (i = 0; i < 3; i++) off[i] = target[i] - d[i] - frame[i];
        before = length;
        length = sqrt(dot(off, off));
        iteration++;
        if (length <= TOLERANCE_M) status = iteration;
        else if (iteration == ITERATIONS || (iteration > 1 && length >= before))
            status = STIFF_NOT_CONVERGED;
        for (i = 0; i < 3; i++) frame[i] += off[i]; /* the TCP that is commanded */
        if (!status && !inverse(frame, command)) status = STIFF_OUT_OF_REACH;
    }
    for (i = 0; i < STIFF_JOINTS && status > 0; i++)
        if (command[i] < fmin(END[2 * i], start[i]) || command[i] > fmax(END[2 * i + 1], start[i]))
            status = STIFF_BEYOND_LIMITS;
    for (i = 0; i < STIFF_JOINTS && status < 0; i++) command[i] = start[i];
    return status;
}
