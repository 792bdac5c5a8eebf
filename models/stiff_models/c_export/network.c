void deflection(const double q[], const double wrench[], double d[]) {
    double x[WIDEST], y[WIDEST];
    const float *weight = NETWORK;
    int layer, i, k;
    encode(q, wrench, x);
    for (i = 0; i < SIZE[0]; i++) x[i] = (float)((x[i] - INPUT[i]) / INPUT[SIZE[0] + i]);
    for (layer = 0; layer < LAYERS; layer++) {
        for (i = 0; i < SIZE[layer + 1]; i++) {
            y[i] = *weight++;
            for (k = 0; k < SIZE[layer]; k++) y[i] += *weight++ * x[k];
        }
        for (i = 0; i < SIZE[layer + 1]; i++) x[i] = layer < LAYERS - 1 ? ACTIVATION(y[i]) : y[i];
    }
    for (k = 0; k < 3; k++) d[k] = x[k] * OUTPUT[3 + k] + OUTPUT[k];
}
#define at_tcp deflection
