/* What finds the first echo of the sea floor in every ping, see waterfall_steps.py for its definition. */

#include "waterfall.h"

/* values, valid (n_pings, n_bins). total, count (n_bins + 1): overwritten. score (n_pings, n_bins): out, where a step
 * may be, else as is. */
WIDE void auv_mcm_waterfall_steps(int64_t n_pings, int64_t n_bins, const double *restrict values,
                                  const uint8_t *restrict valid, int64_t blank, int64_t window, double least_step,
                                  double twice_variance, double *restrict total, double *restrict count,
                                  double *restrict score)
{
    const int64_t begin = blank + 3, end = n_bins - window;
    const double half = 0.5 * (double)window;
    for (int64_t ping = 0; ping < n_pings; ping++) {
        double sum = 0.0, number = 0.0;
        double *restrict out = score + ping * n_bins;
        total[0] = count[0] = 0.0;
        for (int64_t bin = 0; bin < n_bins; bin++) {
            const int32_t sure = valid[ping * n_bins + bin] != 0;
            total[bin + 1] = sum += sure ? values[ping * n_bins + bin] : 0.0;
            count[bin + 1] = number += (double)sure;
        }
#define STEP(START)                                                                                              \
    {                                                                                                            \
        const double n_after = count[bin + window] - count[bin], n_near = count[bin] - count[START];             \
        const double n_column = count[bin] - count[blank], both = n_near + n_after;                              \
        const double after = (total[bin + window] - total[bin]) / (n_after > 1.0 ? n_after : 1.0);               \
        const double near = (total[bin] - total[START]) / (n_near > 1.0 ? n_near : 1.0);                         \
        const double column = (total[bin] - total[blank]) / (n_column > 1.0 ? n_column : 1.0);                   \
        const double rise = after - near;                                                                        \
        const double ratio = n_near * n_after / (both > 1.0 ? both : 1.0) * (rise * rise) / twice_variance;      \
        const int32_t step = (rise > 0.0) & (after - column > least_step) & (n_near >= 3.0) & (n_after >= half); \
        out[bin] = step ? ratio : 0.0;                                                                           \
    }
        const int64_t whole = at_most(blank + window > begin ? blank + window : begin, end);
        for (int64_t bin = begin; bin < whole; bin++)
            STEP(blank)
        for (int64_t bin = whole; bin < end; bin++)
            STEP(bin - window)
#undef STEP
    }
}

/* ratios, score (n_pings, n_bins); score: adds each ping's ratios times share, brought to the same highest value, vote,
 * unless that is less than evidence.
 */
WIDE void auv_mcm_waterfall_votes(int64_t n_pings, int64_t n_bins, const double *restrict ratios, double share,
                                  double vote, double evidence, double *restrict score)
{
    for (int64_t ping = 0; ping < n_pings; ping++) {
        const double *restrict ratio = ratios + ping * n_bins;
        double *restrict sum = score + ping * n_bins;
        double highest[8];
        for (int64_t k = 0; k < 8; k++)
            highest[k] = evidence;
        for (int64_t bin = 0; bin + 8 <= n_bins; bin += 8)
            for (int64_t k = 0; k < 8; k++)
                highest[k] = share * ratio[bin + k] > highest[k] ? share * ratio[bin + k] : highest[k];
        for (int64_t bin = n_bins - n_bins % 8; bin < n_bins; bin++)
            highest[0] = share * ratio[bin] > highest[0] ? share * ratio[bin] : highest[0];
        for (int64_t k = 1; k < 8; k++)
            highest[0] = highest[k] > highest[0] ? highest[k] : highest[0];
        const double factor = vote / highest[0];
        for (int64_t bin = 0; bin < n_bins; bin++)
            sum[bin] += share * ratio[bin] * factor;
    }
}

/* altitude (n_pings), NaN where unknown. score (n_pings, n_bins): takes `gate` off bins, of bin_m each, at ranges
 * beyond `ratio` of the altitude, either way, and off each `pull` times the logarithm of its range over the altitude.
 */
void auv_mcm_waterfall_pull(int64_t n_pings, int64_t n_bins, const double *restrict altitude, double bin_m,
                            double ratio, double gate, double pull, double *restrict score)
{
    for (int64_t ping = 0; ping < n_pings; ping++) {
        const double reading = altitude[ping];
        double *restrict to = score + ping * n_bins;
        if (!(reading > 0.0 && reading < INFINITY))
            continue;
        for (int64_t bin = 0; bin < n_bins; bin++) {
            const double range = (double)bin * bin_m, from = range > bin_m ? range : bin_m;
            const double off = (range > ratio * reading) | (range * ratio < reading) ? gate : 0.0;
            to[bin] = to[bin] - off - fabs(log(from / reading)) * pull;
        }
    }
}
