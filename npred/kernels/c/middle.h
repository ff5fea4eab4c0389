/* u at the middle of cell j by the cubic through four nodes, one-sided in the end cells; linear where nx < 4. */
static inline void middle(int size, int j, int last, int lanes, int width, int stride, const double *u, double *out)
{
    const ptrdiff_t row = (ptrdiff_t)size * lanes;
    const double *v = u + j * row;
    for (int c = 0; c < size; c++) {
        for (int l = 0; l < width; l++) {
            const double *w = v + c * lanes + l;
            double *mean = out + c * stride + l;
            if (last < 3) {
                *mean = 0.5 * (w[0] + w[row]);
            } else if (j == 0) {
                *mean = 0.3125 * w[0] + 0.9375 * w[row] + -0.3125 * w[2 * row] + 0.0625 * w[3 * row];
            } else if (j == last - 1) {
                *mean = 0.0625 * *(w - 2 * row) + -0.3125 * *(w - row) + 0.9375 * w[0] + 0.3125 * w[row];
            } else {
                *mean = -0.0625 * *(w - row) + 0.5625 * w[0] + 0.5625 * w[row] + -0.0625 * w[2 * row];
            }
        }
    }
}
