/* Class means in context: costs, mean field and means in turn, see fit_means of confirm/mean_field.py. */

#include <math.h>
#include <stdint.h>

#include "wide.h"

enum { BACKGROUND, SHADOW, HIGHLIGHT, LABELS };

#define MOST 50.0 /* nats by which a cell's costs differ */

/* What sets the means, as fit_means lists it. */
typedef struct {
    double looks, start[LABELS], glint, spike, own_share, own_weight, least_samples, shadow[2], highlight[2];
} Rules;

void auv_mcm_pair_costs(int64_t n_rows, int64_t n_columns, const uint8_t *restrict label,
                        const int64_t *restrict reach, int64_t attached, const double *restrict scalars,
                        double *restrict sums, double *restrict behind, double *restrict before, double *restrict cost);
void auv_mcm_mean_field(int64_t n_rows, int64_t n_columns, const double *restrict cost, const double *restrict weight,
                        int64_t n_sweeps, double *restrict probability, double *restrict beside,
                        double *restrict across);

static inline double smaller(double a, double b) { return a < b ? a : b; }
static inline double larger(double a, double b) { return a > b ? a : b; }

WIDE static void weigh_data(int64_t size, const double *restrict intensity, const double *restrict information,
                            const Rules *rules, const double *mean, double *restrict cost)
{
    const double looks = rules->looks, most = rules->glint * mean[HIGHLIGHT];
    const double floor_mean = mean[BACKGROUND], dark_mean = mean[SHADOW], bright_mean = mean[HIGHLIGHT];
    const double floor_log = log(floor_mean), dark_log = log(dark_mean), bright_log = log(bright_mean);
    double *restrict dark_cost = cost + size, *restrict bright_cost = cost + 2 * size;

    for (int64_t k = 0; k < size; k++) {
        const double seen = smaller(intensity[k], most);
        const double floor = looks * (seen / floor_mean + floor_log), dark = looks * (seen / dark_mean + dark_log),
                     bright = looks * (seen / bright_mean + bright_log);
        const double least = smaller(smaller(floor, dark), bright);
        cost[k] = smaller((floor - least) * information[k], MOST);
        dark_cost[k] = smaller((dark - least) * information[k], MOST);
        bright_cost[k] = smaller((bright - least) * information[k], MOST);
    }
}

static void start_probabilities(int64_t size, const double *restrict cost, double *restrict probability)
{
    for (int64_t k = 0; k < size; k++) {
        const double floor = cost[k], dark = cost[size + k], bright = cost[2 * size + k];
        const double least = smaller(smaller(floor, dark), bright);
        const double p = exp(least - floor), q = exp(least - dark), r = exp(least - bright), total = p + q + r;
        probability[k] = p / total;
        probability[size + k] = q / total;
        probability[2 * size + k] = r / total;
    }
}

WIDE static void choose_labels(int64_t size, const double *restrict probability, uint8_t *restrict label)
{
    const double *restrict dark = probability + size, *restrict bright = probability + 2 * size;

    for (int64_t k = 0; k < size; k++) {
        const uint8_t first = dark[k] > probability[k] ? SHADOW : BACKGROUND;
        label[k] = bright[k] > larger(probability[k], dark[k]) ? HIGHLIGHT : first;
    }
}

WIDE static void add_prior(int64_t size, const double *restrict prior, const double *restrict samples,
                           double *restrict cost)
{
    for (int64_t k = 0; k < size; k++)
        cost[k] += prior[k] * smaller(samples[k], 1.0);
}

/* number, total (LABELS): independent samples of each label, and of their intensities, spikes cut off. */
static void add_up(int64_t size, const double *restrict intensity, const double *restrict samples,
                   const double *restrict probability, double own_share, double spike, const double *mean,
                   double *number, double *total)
{
    for (int label = 0; label < LABELS; label++) {
        const double brightest = spike * mean[label];
        double n = 0.0, sum = 0.0;
        for (int64_t k = 0; k < size; k++) {
            const double p = probability[label * size + k], share = p < own_share ? 0.0 : p * samples[k];
            n += share;
            sum += share * smaller(intensity[k], brightest);
        }
        number[label] = n;
        total[label] = sum;
    }
}

static double within(double level, const double *limits, double background)
{
    return smaller(larger(level, limits[0] * background), limits[1] * background);
}

/* intensity, samples, information (n_rows, n_columns), weight (4), reach, attached and lacks as in mean_field.c and
 * pair_costs.c. numbers: as in Rules. probability (LABELS, n_rows, n_columns): out. label (n_rows, n_columns), room (8
 * n_rows n_columns + 2 n_columns + 2): overwritten. found (LABELS + 2): out, the means and the samples of shadow and of
 * highlight.
 */
void auv_mcm_field_means(int64_t n_rows, int64_t n_columns, int64_t n_rounds, int64_t n_sweeps,
                         const double *restrict intensity, const double *restrict samples,
                         const double *restrict information, const double *restrict weight,
                         const int64_t *restrict reach, int64_t attached, const double *restrict lacks,
                         const double *restrict numbers, double *restrict probability, uint8_t *restrict label,
                         double *restrict room, double *restrict found)
{
    const Rules *const rules = (const Rules *)numbers;
    const int64_t size = n_rows * n_columns;
    double *cost = room, *prior = room + LABELS * size, *behind = room + 2 * LABELS * size, *before = behind + size;
    double mean[LABELS], number[LABELS] = {0.0}, total[LABELS];

    for (int k = 0; k < LABELS; k++)
        mean[k] = rules->start[k];
    for (int64_t round = 0; round < n_rounds; round++) {
        weigh_data(size, intensity, information, rules, mean, cost);
        if (round == 0)
            start_probabilities(size, cost, probability);
        choose_labels(size, probability, label);
        auv_mcm_pair_costs(n_rows, n_columns, label, reach, attached, lacks, before + size, behind, before, prior);
        for (int k = SHADOW; k < LABELS; k++)
            add_prior(size, prior + k * size, samples, cost + k * size);
        auv_mcm_mean_field(n_rows, n_columns, cost, weight, n_sweeps, probability, behind, before);
        add_up(size, intensity, samples, probability, round + 1 < n_rounds ? rules->own_share : 0.0, rules->spike, mean,
               number, total);
        for (int k = 0; k < LABELS; k++)
            mean[k] = (total[k] + rules->own_weight * rules->start[k]) / (number[k] + rules->own_weight);
        mean[SHADOW] = within(number[SHADOW] >= rules->least_samples ? mean[SHADOW] : rules->start[SHADOW],
                              rules->shadow, mean[BACKGROUND]);
        mean[HIGHLIGHT] = within(number[HIGHLIGHT] >= rules->least_samples ? mean[HIGHLIGHT] : rules->start[HIGHLIGHT],
                                 rules->highlight, mean[BACKGROUND]);
    }
    for (int k = 0; k < LABELS; k++)
        found[k] = mean[k];
    found[LABELS] = number[SHADOW];
    found[LABELS + 1] = number[HIGHLIGHT];
}
