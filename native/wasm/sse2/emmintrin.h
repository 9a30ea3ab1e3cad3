// The SSE2 functions that the core uses, by the vectors of WebAssembly: its forms for SSE2 then run in a browser as
// they are. Compiled with __SSE2__ defined; a function that is missing here is an error of the compiler, and to be
// added.
#pragma once
#include <wasm_simd128.h>

using __m128i = v128_t;
using __m128 = v128_t;

inline __m128i _mm_set1_epi16(short x) { return wasm_i16x8_splat(x); }
inline __m128i _mm_set1_epi32(int x) { return wasm_i32x4_splat(x); }
inline __m128i _mm_setzero_si128() { return wasm_i32x4_const_splat(0); }
inline __m128i _mm_load_si128(const __m128i* from) { return wasm_v128_load(from); }
inline __m128i _mm_loadu_si128(const __m128i* from) { return wasm_v128_load(from); }
inline __m128i _mm_loadl_epi64(const __m128i* from) { return wasm_v128_load64_zero(from); }
inline void _mm_store_si128(__m128i* to, __m128i a) { wasm_v128_store(to, a); }
inline void _mm_storeu_si128(__m128i* to, __m128i a) { wasm_v128_store(to, a); }
inline void _mm_storel_epi64(__m128i* to, __m128i a) { wasm_v128_store64_lane(to, a, 0); }

inline __m128i _mm_and_si128(__m128i a, __m128i b) { return wasm_v128_and(a, b); }
inline __m128i _mm_or_si128(__m128i a, __m128i b) { return wasm_v128_or(a, b); }
inline __m128i _mm_xor_si128(__m128i a, __m128i b) { return wasm_v128_xor(a, b); }
inline __m128i _mm_andnot_si128(__m128i a, __m128i b) { return wasm_v128_andnot(b, a); }  // b and not a

inline __m128i _mm_add_epi16(__m128i a, __m128i b) { return wasm_i16x8_add(a, b); }
inline __m128i _mm_add_epi32(__m128i a, __m128i b) { return wasm_i32x4_add(a, b); }
inline __m128i _mm_adds_epu16(__m128i a, __m128i b) { return wasm_u16x8_add_sat(a, b); }
inline __m128i _mm_subs_epi16(__m128i a, __m128i b) { return wasm_i16x8_sub_sat(a, b); }
inline __m128i _mm_cmpeq_epi16(__m128i a, __m128i b) { return wasm_i16x8_eq(a, b); }
inline __m128i _mm_adds_epi16(__m128i a, __m128i b) { return wasm_i16x8_add_sat(a, b); }
inline __m128i _mm_sub_epi16(__m128i a, __m128i b) { return wasm_i16x8_sub(a, b); }
inline __m128i _mm_sub_epi32(__m128i a, __m128i b) { return wasm_i32x4_sub(a, b); }
inline __m128i _mm_max_epi16(__m128i a, __m128i b) { return wasm_i16x8_max(a, b); }
inline __m128i _mm_min_epi16(__m128i a, __m128i b) { return wasm_i16x8_min(a, b); }
inline __m128i _mm_cmpgt_epi16(__m128i a, __m128i b) { return wasm_i16x8_gt(a, b); }
inline __m128i _mm_cmpgt_epi32(__m128i a, __m128i b) { return wasm_i32x4_gt(a, b); }

inline __m128i _mm_slli_epi32(__m128i a, int by) { return wasm_i32x4_shl(a, static_cast<unsigned>(by)); }
inline __m128i _mm_srai_epi16(__m128i a, int by) { return wasm_i16x8_shr(a, static_cast<unsigned>(by)); }
inline __m128i _mm_srai_epi32(__m128i a, int by) { return wasm_i32x4_shr(a, static_cast<unsigned>(by)); }
inline __m128i _mm_srli_epi16(__m128i a, int by) { return wasm_u16x8_shr(a, static_cast<unsigned>(by)); }

inline __m128i _mm_mullo_epi16(__m128i a, __m128i b) { return wasm_i16x8_mul(a, b); }
inline __m128i _mm_madd_epi16(__m128i a, __m128i b) { return wasm_i32x4_dot_i16x8(a, b); }
// The upper halves of eight products.
inline __m128i _mm_mulhi_epi16(__m128i a, __m128i b) {
  return wasm_i16x8_shuffle(wasm_i32x4_extmul_low_i16x8(a, b), wasm_i32x4_extmul_high_i16x8(a, b), 1, 3, 5, 7, 9, 11,
                            13, 15);
}
inline __m128i _mm_mulhi_epu16(__m128i a, __m128i b) {
  return wasm_i16x8_shuffle(wasm_u32x4_extmul_low_u16x8(a, b), wasm_u32x4_extmul_high_u16x8(a, b), 1, 3, 5, 7, 9, 11,
                            13, 15);
}

// A macro, since what it picks has to be a constant.
#define _mm_shuffle_epi32(a, picked) \
  wasm_i32x4_shuffle(a, a, (picked) & 3, (picked) >> 2 & 3, (picked) >> 4 & 3, (picked) >> 6 & 3)

inline __m128i _mm_packs_epi32(__m128i a, __m128i b) { return wasm_i16x8_narrow_i32x4(a, b); }
inline __m128i _mm_packs_epi16(__m128i a, __m128i b) { return wasm_i8x16_narrow_i16x8(a, b); }
inline int _mm_cvtsi128_si32(__m128i a) { return wasm_i32x4_extract_lane(a, 0); }
inline __m128i _mm_packus_epi16(__m128i a, __m128i b) { return wasm_u8x16_narrow_i16x8(a, b); }
inline __m128 _mm_castsi128_ps(__m128i a) { return a; }
inline int _mm_movemask_ps(__m128 a) { return static_cast<int>(wasm_i32x4_bitmask(a)); }
inline __m128i _mm_castps_si128(__m128 a) { return a; }
inline __m128 _mm_cvtepi32_ps(__m128i a) { return wasm_f32x4_convert_i32x4(a); }
inline __m128i _mm_cvttps_epi32(__m128 a) { return wasm_i32x4_trunc_sat_f32x4(a); }  // the same within 32 bits
inline int _mm_movemask_epi8(__m128i a) { return static_cast<int>(wasm_i8x16_bitmask(a)); }

inline __m128i _mm_unpacklo_epi16(__m128i a, __m128i b) { return wasm_i16x8_shuffle(a, b, 0, 8, 1, 9, 2, 10, 3, 11); }
inline __m128i _mm_unpackhi_epi16(__m128i a, __m128i b) { return wasm_i16x8_shuffle(a, b, 4, 12, 5, 13, 6, 14, 7, 15); }
inline __m128i _mm_unpacklo_epi32(__m128i a, __m128i b) { return wasm_i32x4_shuffle(a, b, 0, 4, 1, 5); }
inline __m128i _mm_unpackhi_epi32(__m128i a, __m128i b) { return wasm_i32x4_shuffle(a, b, 2, 6, 3, 7); }
