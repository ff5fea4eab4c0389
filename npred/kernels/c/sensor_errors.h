/* What sensors make of the plant's state. Random numbers are a function of the seed, the loop, the sample and the state:
 * they depend neither on the batch nor on the order of evaluation. */
enum { NOISE = 1, GAP = 2, DROP = 3, ABSOLUTE = 4 }; /* what a random number is for */

/* A number of (0, 1) that those five decide: SplitMix64 [Steele, Lea, Flood 2014], a round for each. */
static inline double uniform(int64_t seed, int64_t loop, int64_t number, int64_t state, int64_t purpose)
{
    const int64_t parts[] = {seed, loop, number, state, purpose};
    uint64_t z = 0x9E3779B97F4A7C15u;
    for (int k = 0; k < 5; k++) {
        z = (z ^ (uint64_t)parts[k]) + 0x9E3779B97F4A7C15u;
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
        z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
        z = z ^ (z >> 31);
    }
    return ((double)(z >> 11) + 0.5) / 9007199254740992.0; /* 2^53 */
}

/* A standard normal number [Box and Muller 1958]. */
static inline double normal(int64_t seed, int64_t loop, int64_t number, int64_t state, int64_t purpose)
{
    const double radius = sqrt(-2.0 * log(uniform(seed, loop, number, state, purpose)));
    return radius * cos(2.0 * 3.141592653589793 * uniform(seed, loop, number, state, -purpose));
}

/* What sensors make of `count` components of x, one lane of `lanes`, in sample `number` of a loop:
 * y = q(x (1 + relative_noise ξ) + noise η + bias), where q rounds to the nearest multiple of the resolution, half to even.
 * IEEE 754's remainder is exact, where a quotient would be rounded first. */
static inline void read_sensors(int count, int lanes, const Settings *s, int64_t loop, int64_t number, const double *x,
                                double *y)
{
    for (int c = 0; c < count; c++) {
        double value = x[c * lanes];
        if (s->relative_noise[c] != 0.0) {
            value *= 1.0 + s->relative_noise[c] * normal(s->seed, loop, number, c, NOISE);
        }
        if (s->noise[c] != 0.0) {
            value += s->noise[c] * normal(s->seed, loop, number, c, ABSOLUTE);
        }
        value += s->bias[c];
        y[c * lanes] = s->resolution[c] > 0.0 ? value - remainder(value, s->resolution[c]) : value;
    }
}
