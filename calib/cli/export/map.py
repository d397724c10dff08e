# Where shifts are zero, nm; pm that come off for each pm of the reference grating.
_NOMINAL, _SHARES = [@NOMINAL@], [@SHARES@]
_CENTRE, _SCALE = [@CENTRE@], @SCALE@
# Readings of the fit, scaled; the hull of the valid shifts and the margin beyond it, pm.
_FITTED = [@FITTED@]
_HULL, _MARGIN = [@HULL@], @MARGIN@
# Moment by moment: readings and terms, kernel and its shape, offset, variance, nugget, half width.
_MOMENTS = [@MOMENTS@]
_COEFFICIENTS = [[@COEFFICIENTS_1@], [@COEFFICIENTS_2@]]
# Lower triangles of the covariance's factors by rows.
_FACTORS = [[@FACTOR_1@], [@FACTOR_2@]]
# Three inputs, moments, half widths, status.
_STORED = [@STORED@]


def _correlation(kernel, shape, distance):
    u = distance / shape
    s = math.sqrt(5.0) * u
    return 1 + u * u * (2 * u - 3) if kernel == 1 else (1 + s + s * s / 3) * math.exp(-s)


def _outside(x, y):
    nearest, inside = math.inf, len(_HULL) > 2
    for a, b in zip(_HULL, _HULL[1:] + _HULL[:1]):
        ex, ey = b[0] - a[0], b[1] - a[1]
        square = ex * ex + ey * ey
        t = ((x - a[0]) * ex + (y - a[1]) * ey) / square if square > 0 else 0.0
        t = min(max(t, 0.0), 1.0)
        nearest = min(nearest, math.hypot(x - a[0] - t * ex, y - a[1] - t * ey))
        inside = inside and ex * (y - a[1]) - ey * (x - a[0]) >= 0
    return 0.0 if inside else nearest


def _at(first_nm, second_nm, reference_nm):
    reference = 1e3 * (reference_nm - _NOMINAL[2])
    x = 1e3 * (first_nm - _NOMINAL[0]) - _SHARES[0] * reference
    y = 1e3 * (second_nm - _NOMINAL[1]) - _SHARES[1] * reference
    if not (math.isfinite(x) and math.isfinite(y) and _outside(x, y) <= _MARGIN):
        return [math.nan] * 2, [math.nan] * 2, 1
    a, b = (x - _CENTRE[0]) / _SCALE, (y - _CENTRE[1]) / _SCALE
    means, halves = [], []
    for row, coefficients, factor in zip(_MOMENTS, _COEFFICIENTS, _FACTORS):
        readings, terms, kernel, shape, mean, variance, nugget, half = row
        at = [_correlation(kernel, shape, math.hypot(a - u, b - v)) for u, v in _FITTED[:readings]]
        at += [1.0, a, b, a * a, a * b, b * b][:terms]
        spread, q, f = (1.0 if kernel else 0.0), [], 0
        # Forward substitution: what the readings tell comes off, what the trend leaves open comes on.
        for i, r in enumerate(at):
            mean += coefficients[i] * r
            q.append((r - sum(c * v for c, v in zip(factor[f : f + i], q))) / factor[f + i])
            f += i + 1
            spread += -q[i] * q[i] if i < readings else q[i] * q[i]
        means.append(mean)
        halves.append(half * math.sqrt(variance * (max(spread, 0.0) + nugget)))
    return means, halves, 0


def apply(@PARAMETERS@):
    """Moments and half widths of their 95 % intervals, N mm, status (0 inside, 1 outside)."""
    return _at(@ARGUMENTS@)


def self_test():
    failures = 0
    for row in _STORED:
        moments, halves, status = _at(*row[:3])
        pairs = zip([*moments, *halves], row[3:7], [_TOLERANCE[0]] * 2 + [_TOLERANCE[1]] * 2)
        near = all(abs(a - b) <= tolerance for a, b, tolerance in pairs)
        failures += not (status == row[7] and (math.isnan(moments[0]) if row[7] else near))
    return failures
