/* What stands out of single pings, see interference.py for its definition. */

#include "waterfall.h"

enum { PINGS = 5, REACH = 12, STEP = 5 }; /* of interference.py: the window is 2 REACH + 1, five times STEP */

static inline double lower(double a, double b) { return a < b ? a : b; }
static inline double higher(double a, double b) { return a > b ? a : b; }

/* Sum of the middle two of four pings, with its ends repeated REACH times. */
WIDE static void middle_two(int64_t n, const double *restrict a, const double *restrict b, const double *restrict c,
                            const double *restrict d, double *restrict padded)
{
    double *restrict middle = padded + REACH;
    for (int64_t k = 0; k < n; k++)
        middle[k] = higher(lower(a[k], b[k]), lower(c[k], d[k])) + lower(higher(a[k], b[k]), higher(c[k], d[k]));
    for (int64_t k = 0; k < REACH; k++) {
        padded[k] = middle[0];
        middle[n + k] = middle[n - 1];
    }
}

/* padded (n + 2 REACH), few (n + 2 REACH): overwritten. around, found (n): out. */
WIDE static void rate(int64_t n, const double *restrict own, const double *restrict padded, double *restrict few,
                      double weak, double strong, double *restrict around, uint8_t *restrict found)
{
    const double share = 2.0 * (2 * REACH + 1) / 3.0; /* of a sum of three columns to one of the window, doubled */
    for (int64_t k = 0; k + STEP <= n + 2 * REACH; k++)
        few[k] = padded[k] + padded[k + 1] + padded[k + 2] + padded[k + 3] + padded[k + 4];
    for (int64_t k = 0; k < n; k++) {
        const double wide = few[k] + few[k + STEP] + few[k + 2 * STEP] + few[k + 3 * STEP] + few[k + 4 * STEP];
        around[k] = higher(wide, STEP * few[k + 2 * STEP]);
        const double here = share * (own[k - 1] + own[k] + own[k + 1]);
        const int32_t stands = (here > weak * around[k]) & (around[k] > 0.0);
        const int32_t much = (here > strong * around[k]) & stands;
        found[k] = (uint8_t)(stands + much);
    }
}

/* intensity (n_pings, n_columns), five pings or more. scratch (3, n_columns + 2 REACH): overwritten. around, found
 * (n_pings, n_columns): out.
 */
void auv_mcm_interference(int64_t n_pings, int64_t n_columns, const double *restrict intensity, double weak,
                          double strong, double *restrict scratch, double *restrict around,
                          uint8_t *restrict found)
{
    const int64_t n = n_columns, wide = n + 2 * REACH;
    double *restrict own = scratch + 2 * wide + 1;
    for (int64_t ping = 0; ping < n_pings; ping++) {
        const int64_t first = ping < PINGS / 2 ? 0 : at_most(ping - PINGS / 2, n_pings - PINGS);
        const double *others[PINGS - 1];
        for (int64_t k = 0, other = first; k < PINGS - 1; other++)
            if (other != ping)
                others[k++] = intensity + other * n;
        middle_two(n, others[0], others[1], others[2], others[3], scratch);
        memcpy(own, intensity + ping * n, (size_t)n * sizeof *own);
        own[-1] = own[0];
        own[n] = own[n - 1];
        rate(n, own, scratch, scratch + wide, weak, strong, around + ping * n, found + ping * n);
    }
}
