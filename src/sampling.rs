//! Owen-scrambled Sobol points, counter-based random bits, and the maps from the square to surfaces and directions.

use glam::{Vec2, Vec3};

/// Mixes `words` into 64 well-distributed bits (the finaliser of splitmix64, Steele et al. 2014).
///
/// Every random decision is a hash of (seed, purpose, index), so that results do not depend on scheduling.
pub fn hash(words: &[u64]) -> u64 {
    let mut h = 0x9e37_79b9_7f4a_7c15_u64;
    for &w in words {
        h = h.wrapping_add(w).wrapping_add(0x9e37_79b9_7f4a_7c15);
        h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        h ^= h >> 31;
    }
    h
}

/// Point `index` of a four-dimensional Owen-scrambled Sobol sequence (Burley 2020), each coordinate in [0, 1).
///
/// `index < 65536`. Sets with different `seed`s are independent; the first 2^m points of each are stratified.
pub fn sobol4(index: u32, seed: u64) -> [f32; 4] {
    sobol_burley::sample_4d(index, 0, (seed ^ (seed >> 32)) as u32)
}

/// Uniform square to uniform unit disc, with low distortion (Shirley & Chiu 1997).
pub fn concentric_disc(u: f32, v: f32) -> Vec2 {
    use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};
    let (a, b) = (2.0 * u - 1.0, 2.0 * v - 1.0);
    if a == 0.0 && b == 0.0 {
        return Vec2::ZERO;
    }
    let (r, phi) = if a.abs() > b.abs() { (a, FRAC_PI_4 * (b / a)) } else { (b, FRAC_PI_2 - FRAC_PI_4 * (a / b)) };
    let (sin, cos) = phi.sin_cos();
    Vec2::new(r * cos, r * sin)
}

/// Cosine-distributed direction about +z; pdf cos / pi, 1/sr.
pub fn cosine_hemisphere(u: f32, v: f32) -> Vec3 {
    let d = concentric_disc(u, v);
    d.extend((1.0 - d.length_squared()).max(0.0).sqrt())
}

/// Two unit vectors that make a right-handed frame with unit `n` (Duff et al. 2017).
pub fn frame(n: Vec3) -> (Vec3, Vec3) {
    let sign = 1.0_f32.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), Vec3::new(b, sign + n.y * n.y * a, -n.y))
}

/// Uniform square to uniform barycentric weights (second, third vertex) of a triangle (Heitz 2019).
pub fn triangle(u: f32, v: f32) -> (f32, f32) {
    let half = 0.5 * u.min(v);
    (u - half, v - half)
}

/// The step of running sums that holds share `u` of the whole, and where in it, both from 0.
pub fn step_of(sums: &[f64], u: f64) -> (usize, f64) {
    let last = sums.len() - 1;
    let target = u * sums[last];
    let i = sums.partition_point(|&s| s <= target).min(last);
    let below = if i == 0 { 0.0 } else { sums[i - 1] };
    let width = sums[i] - below;
    (i, if width > 0.0 { ((target - below) / width).clamp(0.0, 1.0) } else { 0.5 })
}
