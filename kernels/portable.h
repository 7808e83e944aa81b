/* The few words in which OpenCL C and GLSL differ, and the width of a value.

   REAL is one value of a pixel: `float` on a GPU and in GLSL, `float8` (eight neighbouring
   pixels of a row), or `float16` with AVX-512, in OpenCL on a CPU, where PoCL does not vectorise
   loops by itself. The physics
   in the other headers is written once, in the common subset: pure functions of values,
   structs returned, `f` on every literal, no address space, no name that GLSL owns. */
#ifndef PORTABLE_H
#define PORTABLE_H

#ifdef GPUSPEC_GLSL

#define DEVICE
#define STRUCT(name) struct name
#define RECORD(name) struct name
#define REAL float
#define COUNTER uint
#define MASK bool
#define ANY(mask) (mask)
#define LEAST(x) (x)
#define TO_REAL(x) float(x)
#define TO_COUNTER(x) uint(x)
#define FLOAT(i) float(i)
#define UINT(x) uint(x)
#define INT(x) int(x)
#define fabs abs
#define rint roundEven

#else

#define DEVICE static inline
#define FLOAT(i) ((float)(i))
#define UINT(x) ((uint)(x))
#define INT(x) ((int)(x))
#define STRUCT(name) typedef struct name name; struct name
/* Aligned, a compiler loads it by four. */
#define RECORD(name) typedef struct name name; struct __attribute__((aligned(16))) name
#if WIDTH > 1
#define JOINED(a, b) a##b
#define WIDE(type, width) JOINED(type, width)
#define REAL WIDE(float, WIDTH)
#define COUNTER WIDE(uint, WIDTH)
#define MASK WIDE(int, WIDTH)
#define ANY(mask) any(mask)
#define TO_REAL(x) WIDE(convert_float, WIDTH)(x)
#define TO_COUNTER(x) WIDE(convert_uint, WIDTH)(x)
/* Rows are padded to whole vectors, so these are aligned. */
#define LOAD(p, i) (*(__global const REAL *)((p) + (i)))
#define STORE(v, p, i) (*(__global REAL *)((p) + (i)) = (v))
#define LOAD_COUNTERS(p, i) (*(__global const COUNTER *)((p) + (i)))
/* From any place, aligned or not. */
typedef REAL Loose __attribute__((aligned(4)));
#define LOAD_ANYWHERE(p, i) ((REAL)*(__global const Loose *)((p) + (i)))
#define LOAD_PRIVATE(p, i) ((REAL)*(const Loose *)((p) + (i)))
#define STORE_PRIVATE(v, p, i) (*(Loose *)((p) + (i)) = (v))
#define LANE(v, i) ((v)[i])
#define TO_MASK(x) (x)
#define STORE_BYTE(v, p, i) \
    (*(__global WIDE(uchar, WIDTH) *)((p) + (i)) = WIDE(convert_uchar, WIDTH)(v))
#if WIDTH == 16
#ifndef __AVX512F__
#error sixteen pixels at once take AVX-512, and this compiler has none
#endif
#define LANES ((REAL)(0.0f, 1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f, 7.0f, 8.0f, 9.0f, 10.0f, 11.0f, \
                      12.0f, 13.0f, 14.0f, 15.0f))
#define GATHER(p, i) ((REAL)((p)[(i).s0], (p)[(i).s1], (p)[(i).s2], (p)[(i).s3], \
                             (p)[(i).s4], (p)[(i).s5], (p)[(i).s6], (p)[(i).s7], \
                             (p)[(i).s8], (p)[(i).s9], (p)[(i).sa], (p)[(i).sb], \
                             (p)[(i).sc], (p)[(i).sd], (p)[(i).se], (p)[(i).sf]))
#else
#define LANES ((REAL)(0.0f, 1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f, 7.0f))
#define GATHER(p, i) ((REAL)((p)[(i).s0], (p)[(i).s1], (p)[(i).s2], (p)[(i).s3], \
                             (p)[(i).s4], (p)[(i).s5], (p)[(i).s6], (p)[(i).s7]))
#endif
/* The least of a REAL's values. */
#define LEAST(x) least_of(x)
DEVICE float least_of(REAL x) {
#if WIDTH == 16
    float8 eight = x.lo < x.hi ? x.lo : x.hi;
#else
    float8 eight = x;
#endif
    float4 four = eight.lo < eight.hi ? eight.lo : eight.hi;
    float2 two = four.lo < four.hi ? four.lo : four.hi;
    return two.x < two.y ? two.x : two.y;
}
/* PoCL leaves the built-in functions as calls, which spill every register (vload8, vstore8 too):
   in place, the closed form runs 2.4 times and the loop over images 2.5 times faster. */
#if defined(__has_builtin)
#if __has_builtin(__builtin_elementwise_roundeven)
#undef floor
#undef rint
#undef fabs
#undef max
#undef min
#undef clamp
#define floor(x) __builtin_elementwise_floor(x)
#define rint(x) __builtin_elementwise_roundeven(x)
#define fabs(x) __builtin_elementwise_abs(x)
#define max(a, b) greater((REAL)(a), (REAL)(b))
#define min(a, b) lesser((REAL)(a), (REAL)(b))
#define clamp(x, low, high) min(max(x, low), high)
DEVICE REAL greater(REAL a, REAL b) {
    return a > b ? a : b;
}
DEVICE REAL lesser(REAL a, REAL b) {
    return a < b ? a : b;
}
#endif
#if __has_builtin(__builtin_reduce_or)
#undef ANY
#define ANY(mask) (__builtin_reduce_or((MASK)(mask)) != 0)
#endif
#if defined(__AVX__) && __has_builtin(__builtin_ia32_sqrtps256)
#undef sqrt
typedef float Packed __attribute__((vector_size(4 * WIDTH)));
#if WIDTH == 16
#define PACKED_SQRT(x) __builtin_ia32_sqrtps512(x, 4) /* rounded as everything else is */
#else
#define PACKED_SQRT(x) __builtin_ia32_sqrtps256(x)
#endif
#define sqrt(x) __builtin_astype(PACKED_SQRT(__builtin_astype((REAL)(x), Packed)), REAL)
#endif
#endif
#else
#define REAL float
#define COUNTER uint
#define MASK int
#define ANY(mask) (mask)
#define LEAST(x) (x)
#define TO_REAL(x) convert_float(x)
#define TO_COUNTER(x) convert_uint(x)
#define LANES 0.0f
#define LOAD(p, i) (p)[i]
#define STORE(v, p, i) (p)[i] = (v)
#define STORE_BYTE(v, p, i) (p)[i] = (uchar)(v)
#define LOAD_COUNTERS(p, i) (p)[i]
#define LOAD_ANYWHERE(p, i) (p)[i]
#define LOAD_PRIVATE(p, i) (p)[i]
#define STORE_PRIVATE(v, p, i) (p)[i] = (v)
#define LANE(v, i) (v)
#define TO_MASK(x) (x)
#define GATHER(p, i) (p)[i]
#endif

#endif

/* Four values of each pixel. */
STRUCT(Four) {
    REAL a;
    REAL b;
    REAL c;
    REAL d;
};

#ifndef GPUSPEC_GLSL

/* The four floats from place i of each pixel on: one load of all, and they are turned. */
DEVICE Four four_at(__global const float *p, COUNTER i) {
#if WIDTH > 1
#define ROW(k) (*(__global const LooseFour *)(p + i.s##k))
#define ROWS(k, l, m, n) ((float16)(ROW(k), ROW(l), ROW(m), ROW(n)))
    typedef float4 LooseFour __attribute__((aligned(4)));
    float16 first = ROWS(0, 1, 2, 3), second = ROWS(4, 5, 6, 7);
#if WIDTH == 16
#define TURNED(s) ((REAL)(first.s, second.s, third.s, fourth.s))
    float16 third = ROWS(8, 9, a, b), fourth = ROWS(c, d, e, f);
#else
#define TURNED(s) ((REAL)(first.s, second.s))
#endif
    Four four = {TURNED(s048c), TURNED(s159d), TURNED(s26ae), TURNED(s37bf)};
#else
    Four four = {p[i], p[i + 1], p[i + 2], p[i + 3]};
#endif
    return four;
}

#endif
#endif
