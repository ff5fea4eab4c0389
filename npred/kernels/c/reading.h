/* How u is read between nodes. A node has the mean of u over its cell, which ends half way to the next nodes. Of that
 * mean m, m - q is of the lower half of the cell and m + q of the upper one. With the rises d1 and d2 of u to the node and
 * from it, q is (d1 + d2) / 8, as of a smooth u, and more where the rises d0 and d3 outside of them are smaller: there u
 * jumps inside the cell, and the mean says where. The halves stay between the nodes beside. Compare Harten, J. Comput.
 * Phys. 83 (1989) 148. */
static INLINED double shift(double d0, double d1, double d2, double d3)
{
    const double all = fabs(d1 + d2), outer = larger(fabs(d0), fabs(d3));
    const double q = smaller(smaller(fabs(d1), fabs(d2)), larger(0.125 * all, 0.5 * all - outer));
    return d1 * d2 > 0.0 ? (d1 > 0.0 ? q : -q) : 0.0;
}

/* u from node j to the next one: the straight line through the means of the two halves, less steep where it would leave
 * the values of the nodes. Its mean is that of u, and so the sum over all cells. q (size, stride): the shift of node j, 0
 * of the first one, then that of the next. */
static inline void line(int size, int j, int last, int lanes, int width, int stride, const double *restrict u,
                        double *restrict q, double *restrict begin, double *restrict half, double *restrict end)
{
    const ptrdiff_t row = (ptrdiff_t)size * lanes, low = j > 0 ? -row : 0;
    const ptrdiff_t high = j < last - 1 ? 2 * row : row, beyond = j < last - 2 ? 3 * row : high;
    for (int c = 0; c < size; c++) {
        const double *v = u + j * row + c * lanes;
        LANES for (int l = 0; l < width; l++) {
            const double *w = v + l;
            const int at = c * stride + l;
            const double rise = w[row] - w[0], before = j > 0 ? q[at] : 0.0;
            const double after = shift(w[0] - w[low], rise, w[high] - w[row], w[beyond] - w[high]);
            const double first = 0.5 * (rise + before - after), mean = w[0] + first;
            const double room = smaller(fabs(first), fabs(rise - first));
            const double slope = larger(smaller(rise - before - after, room), -room);
            q[at] = after;
            begin[at] = mean - slope;
            half[at] = mean;
            end[at] = mean + slope;
        }
    }
}
