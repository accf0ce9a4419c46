//! Where the errors are measured.

use glam::Vec3;

use crate::{
    Scene, sampling,
    scene::{SurfacePoint, Triangle},
};

/// `count` points uniformly by area over all sides of surfaces that receive light, the same for equal seeds.
///
/// Points `from ..` of an endless sequence: whoever finds some of them hidden asks for more.
pub fn random(scene: &Scene, from: usize, count: usize, seed: u64) -> Vec<SurfacePoint> {
    // Both sides of what is two-sided.
    let sides: Vec<(usize, bool)> = (scene.triangles.iter().enumerate())
        .flat_map(|(t, Triangle { two_sided, .. })| [Some((t, false)), two_sided.then_some((t, true))])
        .flatten()
        .collect();
    let mut sums = Vec::with_capacity(sides.len());
    let mut sum = 0.0;
    for &(t, _) in &sides {
        sum += scene.area(t);
        sums.push(sum);
    }
    (from..from + count)
        .map(|k| {
            let number = |purpose: u64| unit(sampling::hash(&[seed, k as u64, purpose]));
            let side = sums.partition_point(|&s| s <= number(0) * sum).min(sides.len() - 1);
            let (t, back) = sides[side];
            let (u, v) = sampling::triangle(number(1) as f32, number(2) as f32);
            let [a, b, c] = scene.corners_of(t);
            let normal: Vec3 = scene.normal(t);
            SurfacePoint { position: a + u * (b - a) + v * (c - a), normal: if back { -normal } else { normal } }
        })
        .collect()
}

/// The upper 53 bits as a number in [0, 1).
fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::selftest::World;

    #[test]
    fn points_fall_in_proportion_to_the_area_and_are_the_same_again() {
        let mut world = World::new();
        let grey = world.grey(0.5, 0.0);
        world.quad("small", DVec3::ZERO, DVec3::X, DVec3::Y, grey);
        world.quad("large", DVec3::Z, DVec3::Y * 3.0, DVec3::X, grey);
        let scene = world.build().map(|(scene, _)| scene).map_err(|e| e.to_string());
        let scene = scene.as_ref().expect("a scene");
        let points = random(scene, 0, 4000, 7);
        let small = points.iter().filter(|p| p.normal.z > 0.0).count() as f64;
        // Binomial: 4 sigma of 4000 draws with p = 1/4.
        assert!((small - 1000.0).abs() < 4.0 * (4000.0_f64 * 0.25 * 0.75).sqrt(), "{small}");
        assert_eq!(points[1000..1010], random(scene, 1000, 10, 7));
        assert_ne!(points[0], random(scene, 0, 1, 8)[0]);
    }
}
