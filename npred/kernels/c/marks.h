/* Count control step k of loop l, and mark the row that comes next, where the guard answered or the safety filter acted. */
static inline void mark(double is, INDEX row, int lanes, int l, const Settings *s, int64_t *count, uint8_t *rows)
{
    if (is > 0.0) {
        count[l]++;
        if (row < s->row_count) {
            rows[row * lanes + l] = 1;
        }
    }
}

static inline void mark_step(INDEX k, int lanes, int l, const Settings *s, const State *z, Record *out)
{
    const INDEX row = (k + s->every - 1) / s->every;
    mark(z->fallback[l], row, lanes, l, s, out->fallbacks, out->fallback);
    mark(z->filtered[l], row, lanes, l, s, out->changes, out->filtered);
    out->unkept[l] += z->unkept[l] > 0.0;
    if (row < s->row_count) {
        out->promised[row * lanes + l] = z->promised[l] > 0.0;
    }
}
