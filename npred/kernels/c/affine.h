/* y (out) = b + x W of x (in) and W (in, out) for `count` lanes, which lie innermost; without a b, y = x W. The terms of
 * each sum have one order, however many are added at a time. */
SPARE static INLINED void affine(const int count, const int in, const int out, const double *restrict x,
                                 const double *restrict W, const double *restrict b, double *restrict y)
{
    const int whole = in / 4 * 4;
    for (int o = 0; o < out; o++) {
        for (int l = 0; l < count; l++) {
            y[o * count + l] = b ? b[o] : 0.0;
        }
    }
    for (int i = 0; i < whole; i += 4) {
        const double *const w = W + i * out, *const a = x + i * count;
        for (int o = 0; o < out; o++) {
            for (int l = 0; l < count; l++) {
                const double s = y[o * count + l] + w[o] * a[l] + w[out + o] * a[count + l];
                y[o * count + l] = s + w[2 * out + o] * a[2 * count + l] + w[3 * out + o] * a[3 * count + l];
            }
        }
    }
    for (int i = whole; i < in; i++) {
        for (int o = 0; o < out; o++) {
            for (int l = 0; l < count; l++) {
                y[o * count + l] += W[i * out + o] * x[i * count + l];
            }
        }
    }
}
