/* Inputs on few cells, read from the nodes. Positions are counted in nodes, and a node stands for the cell around it.
 * mass, turn and square (nx + 1, m, lanes): the integrals of u, s u and u² from 0 to where the cell of node j begins;
 * second (m, lanes): the sum of j² u of all nodes j, half of the last one's. Both of these are left out if they are NULL. */
static inline void integrals(Shape d, int m, const double *restrict u, double *restrict mass, double *restrict turn,
                             double *restrict square, double *restrict second)
{
    const int last = d.nx - 1;
    const ptrdiff_t row = (ptrdiff_t)m * d.lanes;
    for (ptrdiff_t a = 0; a < row; a++) {
        mass[a] = turn[a] = 0.0;
        mass[row + a] = 0.5 * u[a];
        turn[row + a] = 0.125 * u[a];
        if (square) {
            square[a] = 0.0;
            square[row + a] = 0.5 * u[a] * u[a];
            second[a] = 0.5 * (double)last * (double)last * u[last * row + a];
        }
    }
    for (int j = 1; j < last; j++) { /* sums of all inputs side by side */
        const double *v = u + j * row;
        double *whole = mass + j * row, *lever = turn + j * row;
        for (ptrdiff_t a = 0; a < row; a++) {
            whole[row + a] = whole[a] + v[a];
            lever[row + a] = lever[a] + (double)j * v[a];
            if (square) {
                square[(j + 1) * row + a] = square[j * row + a] + v[a] * v[a];
                second[a] += (double)j * (double)j * v[a];
            }
        }
    }
    for (ptrdiff_t a = 0; a < row; a++) {
        mass[d.nx * row + a] = mass[last * row + a] + 0.5 * u[last * row + a];
        turn[d.nx * row + a] = turn[last * row + a] + (0.5 * (double)last - 0.125) * u[last * row + a];
        if (square) {
            square[d.nx * row + a] = square[last * row + a] + 0.5 * u[last * row + a] * u[last * row + a];
        }
    }
}

/* v (2 count, m, lanes): begin and end of the straight line on each cell that is nearest to u in the mean square. With
 * `square`, rest (count, m, lanes) is the integral of the squared difference of u from it. */
static inline void lines_on_cells(Shape d, int m, int count, const double *u, const double *mass, const double *turn,
                                  const double *square, double *v, double *rest)
{
    const int last = d.nx - 1;
    const ptrdiff_t row = (ptrdiff_t)m * d.lanes;
    const double wide = (double)last / (double)count;
    for (int cell = 0; cell < count; cell++) {
        const double low = (double)cell * wide, high = (double)(cell + 1) * wide, middle = 0.5 * (low + high);
        const int i = least((int)(low + 0.5), last), j = least((int)(high + 0.5), last);
        const double a = low - larger((double)i - 0.5, 0.0), b = high - larger((double)j - 0.5, 0.0);
        const double lever_a = a * (low - 0.5 * a), lever_b = b * (high - 0.5 * b);
        double *begin = v + 2 * cell * row, *end = begin + row;
        for (ptrdiff_t k = 0; k < row; k++) {
            const double u_i = u[i * row + k], u_j = u[j * row + k];
            const double whole = mass[j * row + k] - mass[i * row + k] + b * u_j - a * u_i;
            const double lean = turn[j * row + k] - turn[i * row + k] + lever_b * u_j - lever_a * u_i - middle * whole;
            const double mean = whole / wide, half = 6.0 * lean / (wide * wide);
            begin[k] = mean - half;
            end[k] = mean + half;
            if (square) {
                const double whole_square = square[j * row + k] - square[i * row + k] + b * u_j * u_j - a * u_i * u_i;
                rest[cell * row + k] = larger(whole_square - wide * (mean * mean + half * half / 3.0), 0.0);
            }
        }
    }
}

/* v (count + 1, m, lanes): the mean of u around each node of a grid of `count` intervals. */
static inline void means_on_nodes(Shape d, int m, int count, const double *u, const double *mass, double *v)
{
    const int last = d.nx - 1;
    const ptrdiff_t row = (ptrdiff_t)m * d.lanes;
    const double stride = (double)last / (double)count;
    for (int node = 0; node <= count; node++) {
        const double low = larger(((double)node - 0.5) * stride, 0.0),
                     high = smaller(((double)node + 0.5) * stride, (double)last);
        const int i = least((int)(low + 0.5), last), j = least((int)(high + 0.5), last);
        const double a = low - larger((double)i - 0.5, 0.0), b = high - larger((double)j - 0.5, 0.0);
        for (ptrdiff_t k = 0; k < row; k++) {
            const double whole = mass[j * row + k] - mass[i * row + k] + b * u[j * row + k] - a * u[i * row + k];
            v[node * row + k] = whole / (high - low);
        }
    }
}
