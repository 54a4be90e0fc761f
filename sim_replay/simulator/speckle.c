/* Speckle of side-scan rows; speckle.py defines it and holds the numpy twin, which gives the same bytes.
 *
 * No Python.h and no shared state: rows may be computed by several threads at once. Compile with -O3 -ffp-contract=off.
 */

#include <math.h>
#include <stdint.h>

#define BLOCK 512     /* columns at a time: all buffers together stay in the first-level cache */
#define MAX_TAPS 1023 /* speckle.py refuses more */
#define EXTENT (BLOCK + MAX_TAPS - 1)
#define FIELD 2047u /* table entries - 1 */

/* AVX2 where the machine has it, half as fast again; there are no fused operations in it, so the bytes are the same.
 * Table lookups are left out: gathers gain little, and lose much on processors patched against reading through them. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#define CLONED __attribute__((target_clones("avx2", "default"))) static
#else
#define CLONED static
#endif

/* Two words of random bits per column. The key is injected twice: rows whose counters overlap still differ. */
CLONED void random_words(int64_t n, uint32_t column, uint64_t key, uint32_t *restrict first, uint32_t *restrict second)
{
    const uint32_t low = (uint32_t)key, high = (uint32_t)(key >> 32);

    for (int64_t i = 0; i < n; i++) {
        uint32_t word = (column + (uint32_t)i) * 0x9E3779B9u + low;
        word ^= word >> 16;
        word *= 0x7FEB352Du;
        word += high;
        word ^= word >> 15;
        word *= 0x846CA68Bu;
        word ^= word >> 16;
        first[i] = word;
        word *= 0x9E3779B1u;
        word ^= word >> 15;
        second[i] = word;
    }
}

static void gaussians(int64_t n, const uint32_t *restrict first, const uint32_t *restrict second,
                      const float *restrict table, float *restrict real, float *restrict imaginary)
{
    for (int64_t i = 0; i < n; i++) {
        real[i] = table[first[i] & FIELD] + table[first[i] >> 21];
        imaginary[i] = table[second[i] & FIELD] + table[second[i] >> 21];
    }
}

CLONED void scale(int64_t n, const float *restrict amplitude, float *restrict real, float *restrict imaginary)
{
    for (int64_t i = 0; i < n; i++) {
        real[i] *= amplitude[i];
        imaginary[i] *= amplitude[i];
    }
}

/* out[i] = sum over t of taps[t] * in[i + t], in that order. */
CLONED void filter(int64_t n, const float *restrict in, int64_t n_taps, const float *restrict taps, float *restrict out)
{
    for (int64_t i = 0; i < n; i++)
        out[i] = taps[0] * in[i];
    for (int64_t t = 1; t < n_taps; t++)
        for (int64_t i = 0; i < n; i++)
            out[i] += taps[t] * in[i + t];
}

CLONED void add_power(int64_t n, const float *restrict real, const float *restrict imaginary, float *restrict sum)
{
    for (int64_t i = 0; i < n; i++)
        sum[i] += real[i] * real[i] + imaginary[i] * imaginary[i];
}

CLONED void weigh(int64_t n, const double *restrict energy, float weight, float *restrict sum)
{
    for (int64_t i = 0; i < n; i++)
        sum[i] *= (float)energy[i] * weight;
}

static void clear(int64_t n, float *restrict sum)
{
    for (int64_t i = 0; i < n; i++)
        sum[i] = 0.0f;
}

/* One row without a filter: energy times the mean power of the looks, no square root. */
static void white_row(int64_t n_columns, const double *energy, const uint64_t *keys, int64_t key_stride,
                      int64_t n_looks, const float *table, float weight, float *intensity)
{
    uint32_t first[BLOCK], second[BLOCK];
    float real[BLOCK], imaginary[BLOCK];

    for (int64_t begin = 0; begin < n_columns; begin += BLOCK) {
        const int64_t n = n_columns - begin < BLOCK ? n_columns - begin : BLOCK;
        clear(n, intensity + begin);
        for (int64_t look = 0; look < n_looks; look++) {
            random_words(n, (uint32_t)begin, keys[look * key_stride], first, second);
            gaussians(n, first, second, table, real, imaginary);
            add_power(n, real, imaginary, intensity + begin);
        }
        weigh(n, energy + begin, weight, intensity + begin);
    }
}

static void filtered_row(int64_t n_columns, const double *energy, const uint64_t *keys, int64_t key_stride,
                         int64_t n_looks, const float *table, const float *taps, int64_t n_taps, float weight,
                         float *intensity)
{
    uint32_t first[EXTENT], second[EXTENT];
    float amplitude[EXTENT], real[EXTENT], imaginary[EXTENT], filtered_real[BLOCK], filtered_imaginary[BLOCK];

    for (int64_t begin = 0; begin < n_columns; begin += BLOCK) {
        const int64_t n = n_columns - begin < BLOCK ? n_columns - begin : BLOCK;
        const int64_t origin = begin - n_taps / 2, extent = n + n_taps - 1;
        for (int64_t i = 0; i < extent; i++) {
            const int64_t column = origin + i;
            amplitude[i] = sqrtf((float)energy[column < 0 ? 0 : column < n_columns ? column : n_columns - 1] * weight);
        }
        clear(n, intensity + begin);
        for (int64_t look = 0; look < n_looks; look++) {
            random_words(extent, (uint32_t)origin, keys[look * key_stride], first, second);
            gaussians(extent, first, second, table, real, imaginary);
            scale(extent, amplitude, real, imaginary);
            filter(n, real, n_taps, taps, filtered_real);
            filter(n, imaginary, n_taps, taps, filtered_imaginary);
            add_power(n, filtered_real, filtered_imaginary, intensity + begin);
        }
    }
}

/* Mean intensity of the looks of n_rows rows.
 *
 * energy (n_rows, n_columns), keys (n_looks, n_rows), table (2048), taps (n_taps), intensity (n_rows, n_columns):
 * C-contiguous. n_taps odd and at most MAX_TAPS; n_looks at least 1.
 */
void auv_mcm_speckle_rows(int64_t n_rows, int64_t n_columns, const double *energy, const uint64_t *keys,
                          int64_t n_looks, const float *table, const float *taps, int64_t n_taps, float *intensity)
{
    const float weight = (float)(0.5 / (double)n_looks); /* a complex sample of two unit Gaussians has power 2 */

    for (int64_t row = 0; row < n_rows; row++) {
        const double *row_energy = energy + row * n_columns;
        float *row_intensity = intensity + row * n_columns;
        if (n_taps == 1)
            white_row(n_columns, row_energy, keys + row, n_rows, n_looks, table, weight, row_intensity);
        else
            filtered_row(n_columns, row_energy, keys + row, n_rows, n_looks, table, taps, n_taps, weight,
                         row_intensity);
    }
}
