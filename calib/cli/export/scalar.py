# Lowest and highest input, and what is valid beyond them, table by table.
_ENDS = [@ENDS@]
# First piece of each table.
_FIRST = [@FIRST@]
# Share of the input's range from which on a piece holds; cubics of value and half width.
_PIECES = [@PIECES@]
# Temperatures of the tables, which are interpolated.
_DIRECTIONS, _PLACES = @DIRECTIONS@, @PLACES@
_DEGC = [@DEGC@]
# Input, temperature, direction, value, half width, status.
_STORED = [@STORED@]


def _at(x, degc, direction):
    outside = (math.nan, math.nan, 1)
    start = _PLACES if _DIRECTIONS == 2 and direction < 0 else 0
    if _DIRECTIONS == 2 and direction not in (1, -1):
        return outside
    if _PLACES > 1 and not _DEGC[0] <= degc <= _DEGC[-1]:
        return outside
    weight = [math.prod((degc - b) / (a - b) for b in _DEGC if b != a) for a in _DEGC]
    low, high, below, above = (
        sum(w * _ENDS[start + k][j] for k, w in enumerate(weight)) for j in range(4)
    )
    if not low - below <= x <= high + above:
        return outside
    share = min(max((x - low) / (high - low), 0.0), 1.0)
    value = half95 = 0.0
    for k, w in enumerate(weight):
        first, last = _FIRST[start + k], _FIRST[start + k + 1]
        while last - first > 1:
            middle = (first + last) // 2
            if _PIECES[middle][0] <= share:
                first = middle
            else:
                last = middle
        p = _PIECES[first]
        d = share - p[0]
        value += w * (p[1] + d * (p[2] + d * (p[3] + d * p[4])))
        half95 += w * (p[5] + d * (p[6] + d * (p[7] + d * p[8])))
    return value, half95, 0


def apply(@PARAMETERS@):
    """Value, half width of its 95 % interval, status (0 inside, 1 outside the valid range)."""
    return _at(@ARGUMENTS@)


def self_test():
    failures = 0
    for *given, value, half95, status in _STORED:
        v, h, s = _at(*given)
        near = abs(v - value) <= _TOLERANCE[0] and abs(h - half95) <= _TOLERANCE[1]
        failures += not (s == status and (math.isnan(v) if status else near))
    return failures
