/* @ORIGIN@
   cal_apply takes @INPUTS@ and gives what it stands for with its 95 % half width.
   C99 with math.h alone; no allocation. Run cal_self_test once where it is used: it returns the
   number of stored answers that are missed. status 1: outside the valid range, value NaN. */
#ifndef CAL_H
#define CAL_H
#include <math.h>

#define CAL_CONTENT_SHA256 "@SHA256@" /* of calibration.json */
#define CAL_SESSION "@SESSION@"
#define CAL_EXPIRES "@EXPIRES@" /* RFC 3339; empty: no expiry */
#define CAL_VERIFICATION "@VERIFICATION@"
#define CAL_SIMULATED @SIMULATED@ /* 1: the calibration comes from simulated data */
#define CAL_INPUT_UNIT "@INPUT_UNIT@"
#define CAL_OUTPUT_UNIT "@OUTPUT_UNIT@"

static const double cal_tolerance[] = {@TOLERANCE@};
