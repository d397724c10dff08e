/* Lowest and highest input, and what is valid beyond them, table by table. */
static const double cal_ends[][4] = {@ENDS@};
/* First piece of each table. */
static const int cal_first[] = {@FIRST@};
/* Share of the input's range from which on a piece holds; cubics of value and half width. */
static const double cal_pieces[][9] = {@PIECES@};
/* Temperatures of the tables, which are interpolated. */
enum { cal_directions = @DIRECTIONS@, cal_places = @PLACES@ };
static const double cal_degc[] = {@DEGC@};
/* Input, temperature, direction, value, half width, status. */
static const double cal_stored[][6] = {@STORED@};

typedef struct {
    double value;
    double half95; /* half width of the 95 % interval */
    int status;    /* 0 inside, 1 outside the valid range */
} cal_result;

static inline cal_result cal_at(double input, double degc, double direction)
{
    cal_result out = {NAN, NAN, 1};
    double weight[cal_places], ends[4] = {0.0, 0.0, 0.0, 0.0}, share;
    const int from = cal_directions == 2 && direction < 0.0 ? cal_places : 0;
    if (cal_directions == 2 && direction != 1.0 && direction != -1.0)
        return out;
    if (cal_places > 1 && !(degc >= cal_degc[0] && degc <= cal_degc[cal_places - 1]))
        return out;
    for (int k = 0; k < cal_places; k++) {
        weight[k] = 1.0;
        for (int j = 0; j < cal_places; j++)
            if (j != k)
                weight[k] *= (degc - cal_degc[j]) / (cal_degc[k] - cal_degc[j]);
        for (int j = 0; j < 4; j++)
            ends[j] += weight[k] * cal_ends[from + k][j];
    }
    if (!(input >= ends[0] - ends[2] && input <= ends[1] + ends[3]))
        return out;
    share = (input - ends[0]) / (ends[1] - ends[0]);
    share = share < 0.0 ? 0.0 : share > 1.0 ? 1.0 : share;
    out.value = out.half95 = 0.0;
    out.status = 0;
    for (int k = 0; k < cal_places; k++) {
        int low = cal_first[from + k], high = cal_first[from + k + 1];
        while (high - low > 1) {
            const int middle = (low + high) / 2;
            if (cal_pieces[middle][0] <= share)
                low = middle;
            else
                high = middle;
        }
        const double *p = cal_pieces[low], d = share - p[0];
        out.value += weight[k] * (p[1] + d * (p[2] + d * (p[3] + d * p[4])));
        out.half95 += weight[k] * (p[5] + d * (p[6] + d * (p[7] + d * p[8])));
    }
    return out;
}

static inline cal_result cal_apply(@PARAMETERS@)
{
    return cal_at(@ARGUMENTS@);
}

static inline int cal_self_test(void)
{
    int failures = 0;
    for (unsigned i = 0; i < sizeof cal_stored / sizeof *cal_stored; i++) {
        const double *s = cal_stored[i];
        const cal_result r = cal_at(s[0], s[1], s[2]);
        if (s[5] != 0.0)
            failures += !(r.status == 1 && isnan(r.value));
        else
            failures += !(r.status == 0 && fabs(r.value - s[3]) <= cal_tolerance[0]
                          && fabs(r.half95 - s[4]) <= cal_tolerance[1]);
    }
    return failures;
}
#endif
