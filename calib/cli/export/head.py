# @ORIGIN@
"""apply takes @INPUTS@ and gives what it stands for with its 95 % half width.

Run self_test once where it is used: it returns the number of stored answers that are missed.
status 1: outside the valid range, value NaN.
"""
import math

CONTENT_SHA256 = "@SHA256@"  # of calibration.json
SESSION = "@SESSION@"
EXPIRES = "@EXPIRES@"  # RFC 3339; empty: no expiry
VERIFICATION = "@VERIFICATION@"
SIMULATED = @SIMULATED@  # 1: the calibration comes from simulated data
INPUT_UNIT = "@INPUT_UNIT@"
OUTPUT_UNIT = "@OUTPUT_UNIT@"

_TOLERANCE = [@TOLERANCE@]
