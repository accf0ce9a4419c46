//! Hits of a short row counted by sorting them, on processors with vectors of 16 numbers.
//!
//! A row meets about a hundred patches of many thousands, here one and there one: counters of all of them do not stay in
//! the nearest cache, and which are used has to be found out again. 256 numbers are sorted in 16 registers, without a
//! branch.

use multiversion::{multiversion, target::match_target};

/// Most hits that are sorted.
pub const MOST: usize = 256;

/// Puts the hits of both `parts` in order, as (hit, count); false if they are more than [`MOST`] or this processor has
/// no such vectors.
#[multiversion(targets("x86_64+avx512f"))]
pub fn count(parts: [&[u32]; 2], out: &mut Vec<(u32, u32)>) -> bool {
    if parts[0].len() + parts[1].len() > MOST {
        return false;
    }
    match_target! {
        "x86_64+avx512f" => {
            avx512::count(parts, out);
            true
        }
        _ => {
            let _ = out;
            false
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use std::arch::x86_64::*;

    use super::MOST;

    /// 16 vectors of 16 lanes: number `v` of lane `l` is element 16 l + v.
    type Matrix = [__m512i; 16];

    #[target_feature(enable = "avx512f")]
    pub fn count([first, second]: [&[u32]; 2], out: &mut Vec<(u32, u32)>) {
        // Places that are left stand behind all others.
        let mut hits = [u32::MAX; MOST];
        let len = first.len() + second.len();
        hits[..first.len()].copy_from_slice(first);
        hits[first.len()..len].copy_from_slice(second);
        let mut m: Matrix = bytemuck::cast(hits);
        sort(&mut m);
        runs(&m, len, out);
    }

    #[inline]
    #[target_feature(enable = "avx512f")]
    fn lanes() -> __m512i {
        _mm512_set_epi32(15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0)
    }

    /// Lanes l ^ `D` in the places of l.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn across<const D: i32>(v: __m512i) -> __m512i {
        _mm512_permutexvar_epi32(_mm512_xor_si512(lanes(), _mm512_set1_epi32(D)), v)
    }

    /// The lanes l with bit `D` set.
    const fn with(d: i32) -> u16 {
        let (mut mask, mut l) = (0, 0);
        while l < 16 {
            mask |= ((l & d != 0) as u16) << l;
            l += 1;
        }
        mask
    }

    /// The smaller of each pair to the first, the larger to the second.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn exchange(m: &mut Matrix, a: usize, b: usize) {
        (m[a], m[b]) = (_mm512_min_epu32(m[a], m[b]), _mm512_max_epu32(m[a], m[b]));
    }

    macro_rules! exchange {
        ($m:ident: $($a:literal $b:literal),*) => { $(exchange($m, $a, $b);)* };
    }

    /// The smaller of lanes l and l ^ `D` to the lower, the larger to the upper.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn between<const D: i32>(m: &mut Matrix) {
        for v in m {
            let other = across::<D>(*v);
            *v = _mm512_mask_max_epu32(_mm512_min_epu32(*v, other), const { with(D) }, *v, other);
        }
    }

    /// Of two sorted runs of elements, one behind the other in lanes that differ by `D`, the elements of the first that
    /// are larger change places with those of the second that mirror them: both are bitonic after.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn mirror<const D: i32>(m: &mut Matrix) {
        // The highest bit of D tells which run.
        let upper = const { with((D + 1) / 2) };
        for k in 0..8 {
            let (a, b) = (m[k], m[15 - k]);
            let (of_b, of_a) = (across::<D>(b), across::<D>(a));
            m[k] = _mm512_mask_max_epu32(_mm512_min_epu32(a, of_b), upper, a, of_b);
            m[15 - k] = _mm512_mask_max_epu32(_mm512_min_epu32(b, of_a), upper, b, of_a);
        }
    }

    /// In each lane, the smaller of elements v and v ^ `D` to the lower, the larger to the upper.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn apart<const D: usize>(m: &mut Matrix) {
        // With a filter this loop is not unrolled.
        for v in 0..16 {
            if v & D == 0 {
                exchange(m, v, v | D);
            }
        }
    }

    /// Sorts lanes that are bitonic.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn within(m: &mut Matrix) {
        apart::<8>(m);
        apart::<4>(m);
        apart::<2>(m);
        apart::<1>(m);
    }

    /// Sorts all elements.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn sort(m: &mut Matrix) {
        // Each lane: Green's network of 60 exchanges (Knuth, The Art of Computer Programming 3, 5.3.4).
        apart::<1>(m);
        apart::<2>(m);
        apart::<4>(m);
        apart::<8>(m);
        exchange!(m: 5 10, 6 9, 3 12, 13 14, 4 8, 7 11, 1 2);
        exchange!(m: 1 4, 7 13, 2 8, 11 14);
        exchange!(m: 2 4, 5 6, 9 10, 11 13, 3 8, 7 12);
        exchange!(m: 6 8, 10 12, 3 5, 7 9);
        exchange!(m: 3 4, 5 6, 7 8, 9 10, 11 12);
        exchange!(m: 6 7, 8 9);
        // Runs of 1, 2, 4 and 8 lanes are merged by Batcher's bitonic network.
        mirror::<1>(m);
        within(m);
        mirror::<3>(m);
        between::<1>(m);
        within(m);
        mirror::<7>(m);
        between::<2>(m);
        between::<1>(m);
        within(m);
        mirror::<15>(m);
        between::<4>(m);
        between::<2>(m);
        between::<1>(m);
        within(m);
        transpose::<1>(m);
        transpose::<2>(m);
        transpose::<4>(m);
        transpose::<8>(m);
    }

    /// Swaps bit `D` of the numbers of vectors and lanes.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn transpose<const D: i32>(m: &mut Matrix) {
        let upper = const { with(D) };
        for k in (0..16).filter(|k| k & D as usize == 0) {
            let (a, b) = (m[k], m[k | D as usize]);
            m[k] = _mm512_mask_blend_epi32(upper, a, across::<D>(b));
            m[k | D as usize] = _mm512_mask_blend_epi32(upper, across::<D>(a), b);
        }
    }

    /// Equal ones among the first `len` elements, which are sorted and stand in order.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn runs(m: &Matrix, len: usize, out: &mut Vec<(u32, u32)>) {
        // Hits, and where each begins; with room for a whole vector behind the last.
        let (mut hits, mut begins) = ([0; MOST + 16], [0; MOST + 16]);
        let mut end = 0;
        // Nothing is equal to what stands before the first.
        let mut before = _mm512_set1_epi32(!_mm_cvtsi128_si32(_mm512_castsi512_si128(m[0])));
        for (k, &v) in m.iter().enumerate() {
            let new = _mm512_cmpneq_epu32_mask(v, _mm512_alignr_epi32::<15>(v, before));
            let places = _mm512_add_epi32(lanes(), _mm512_set1_epi32(16 * k as i32));
            put(&mut hits, end, _mm512_maskz_compress_epi32(new, v));
            put(&mut begins, end, _mm512_maskz_compress_epi32(new, places));
            end += new.count_ones() as usize;
            before = v;
        }
        begins[end] = MOST as u32;
        out.clear();
        let counts = begins[1..=end].iter().zip(&begins[..end]).map(|(end, begin)| end - begin);
        out.extend(hits[..end].iter().copied().zip(counts));
        // The last run may have places that were left.
        if len < MOST
            && let Some(last) = out.last_mut()
        {
            last.1 -= (MOST - len) as u32;
            out.pop_if(|last| last.1 == 0);
        }
    }

    #[inline]
    #[target_feature(enable = "avx512f")]
    fn put(to: &mut [u32; MOST + 16], at: usize, v: __m512i) {
        let v: [u32; 16] = bytemuck::cast(v);
        to[at..at + 16].copy_from_slice(&v);
    }
}
