/* Share what the compiler, not the algorithm, requires of the kernels. */

#ifndef AUV_MCM_WIDE_H
#define AUV_MCM_WIDE_H

/* Where the loader can choose, a second version for the wide vectors that most x86 processors have; it rounds the same.
 */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__has_attribute)
#if __has_attribute(target_clones)
#define WIDE __attribute__((target_clones("avx2", "default")))
#endif
#endif
#ifndef WIDE
#define WIDE
#endif

/* Between files of one library alone: called without the loader's table, and no name for others to meet. */
#if defined(__GNUC__)
#define INTERNAL __attribute__((visibility("hidden")))
#else
#define INTERNAL
#endif

#endif
