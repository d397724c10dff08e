enum { cal_readings = @READINGS@, cal_corners = @CORNERS@ };
/* Where shifts are zero, nm; pm that come off for each pm of the reference grating. */
static const double cal_nominal[] = {@NOMINAL@}, cal_shares[] = {@SHARES@};
static const double cal_centre[] = {@CENTRE@}, cal_scale = @SCALE@;
/* Readings of the fit, scaled; the hull of the valid shifts and the margin beyond it, pm. */
static const double cal_fitted[][2] = {@FITTED@};
static const double cal_hull[][2] = {@HULL@}, cal_margin = @MARGIN@;
/* Moment by moment: readings and terms, kernel and its shape, offset, variance, nugget, half width. */
static const double cal_moments[][8] = {@MOMENTS@};
static const double cal_coefficients_1[] = {@COEFFICIENTS_1@}, cal_coefficients_2[] = {@COEFFICIENTS_2@};
/* Lower triangles of the covariance's factors by rows. */
static const double cal_factor_1[] = {@FACTOR_1@}, cal_factor_2[] = {@FACTOR_2@};
/* Three inputs, moments, half widths, status. */
static const double cal_stored[][8] = {@STORED@};

typedef struct {
    double moment_nmm[2];
    double half95_nmm[2]; /* half widths of the 95 % intervals */
    int status;           /* 0 inside, 1 outside the valid region */
} cal_result;

static inline double cal_correlation(double kernel, double shape, double distance)
{
    const double u = distance / shape, s = sqrt(5.0) * u;
    return kernel == 1.0 ? 1.0 + u * u * (2.0 * u - 3.0) : (1.0 + s + s * s / 3.0) * exp(-s);
}

/* Distance from the hull, pm; 0 inside. */
static inline double cal_outside(double x, double y)
{
    double nearest = INFINITY;
    int inside = cal_corners > 2;
    for (int i = 0; i < cal_corners; i++) {
        const double *a = cal_hull[i], *b = cal_hull[(i + 1) % cal_corners];
        const double ex = b[0] - a[0], ey = b[1] - a[1], square = ex * ex + ey * ey;
        double t = square > 0.0 ? ((x - a[0]) * ex + (y - a[1]) * ey) / square : 0.0;
        t = t < 0.0 ? 0.0 : t > 1.0 ? 1.0 : t;
        nearest = fmin(nearest, hypot(x - a[0] - t * ex, y - a[1] - t * ey));
        inside = inside && ex * (y - a[1]) - ey * (x - a[0]) >= 0.0;
    }
    return inside ? 0.0 : nearest;
}

static inline cal_result cal_at(double first_nm, double second_nm, double reference_nm)
{
    cal_result out = {{NAN, NAN}, {NAN, NAN}, 1};
    const double *coefficients[] = {cal_coefficients_1, cal_coefficients_2};
    const double *factors[] = {cal_factor_1, cal_factor_2};
    const double reference = 1e3 * (reference_nm - cal_nominal[2]);
    const double x = 1e3 * (first_nm - cal_nominal[0]) - cal_shares[0] * reference;
    const double y = 1e3 * (second_nm - cal_nominal[1]) - cal_shares[1] * reference;
    const double a = (x - cal_centre[0]) / cal_scale, b = (y - cal_centre[1]) / cal_scale;
    const double trend[] = {1.0, a, b, a * a, a * b, b * b};
    if (!(isfinite(x) && isfinite(y) && cal_outside(x, y) <= cal_margin))
        return out;
    for (int m = 0; m < 2; m++) {
        const double *p = cal_moments[m], *f = factors[m];
        const int readings = (int)p[0], count = readings + (int)p[1];
        double q[cal_readings + 6], mean = p[4], spread = p[2] > 0.0 ? 1.0 : 0.0;
        for (int i = 0; i < count; i++) {
            q[i] = i < readings ? cal_correlation(p[2], p[3], hypot(a - cal_fitted[i][0], b - cal_fitted[i][1]))
                                : trend[i - readings];
            mean += coefficients[m][i] * q[i];
            /* Forward substitution: what the readings tell comes off, what the trend leaves open comes on. */
            for (int j = 0; j < i; j++)
                q[i] -= *f++ * q[j];
            q[i] /= *f++;
            spread += i < readings ? -q[i] * q[i] : q[i] * q[i];
        }
        out.moment_nmm[m] = mean;
        out.half95_nmm[m] = p[7] * sqrt(p[5] * (fmax(spread, 0.0) + p[6]));
    }
    out.status = 0;
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
        int good = r.status == (s[7] != 0.0);
        for (int m = 0; m < 2; m++)
            good = good && (s[7] != 0.0 ? isnan(r.moment_nmm[m])
                                        : fabs(r.moment_nmm[m] - s[3 + m]) <= cal_tolerance[0]
                                              && fabs(r.half95_nmm[m] - s[5 + m]) <= cal_tolerance[1]);
        failures += !good;
    }
    return failures;
}
#endif
