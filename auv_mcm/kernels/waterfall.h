/* What the files of the waterfall share.
 *
 * Nothing but sums, products and quotients in numpy's order, so that numpy gives the same bits; exponentials and
 * angles, which no two libraries round alike, are left to numpy.
 */

#ifndef AUV_MCM_WATERFALL_H
#define AUV_MCM_WATERFALL_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "wide.h"

enum { ROWS_TOGETHER = 4 };
enum { VALID = 1, SATURATED = 2, LOW_RESOLUTION = 4, TURN = 8 }; /* of records.py */

static inline int64_t at_most(int64_t value, int64_t last) { return value < last ? value : last; }

#endif
