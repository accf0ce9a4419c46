//! Lights that go round.

use glam::{DAffine3, DVec3};

use crate::Scene;

/// The places of a light that goes once round the axis through `centre` along `up`, in `frames` equal steps: the first is where
/// it stands. For [`super::Relighter::place`].
pub fn orbit(centre: DVec3, up: DVec3, frames: usize) -> impl Iterator<Item = DAffine3> {
    let axis = up.normalize_or(DVec3::Y);
    (0..frames).map(move |k| {
        if k == 0 {
            // To the bit, so that the first frame needs nothing new.
            return DAffine3::IDENTITY;
        }
        let turn = DAffine3::from_axis_angle(axis, std::f64::consts::TAU * k as f64 / frames as f64);
        DAffine3::from_translation(centre) * turn * DAffine3::from_translation(-centre)
    })
}

/// The middle of the box around the surfaces of a scene, world coordinates.
pub fn middle(scene: &Scene) -> DVec3 {
    let corners = || scene.positions.iter().map(|p| scene.frame.to_world(*p));
    let low = corners().fold(DVec3::INFINITY, DVec3::min);
    let high = corners().fold(DVec3::NEG_INFINITY, DVec3::max);
    if low.is_finite() && high.is_finite() { 0.5 * (low + high) } else { scene.frame.origin }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_orbit_comes_round_at_equal_distance_and_height() {
        let (centre, start) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 7.0, -1.0));
        let places: Vec<DVec3> = orbit(centre, 2.0 * DVec3::Y, 8).map(|p| p.transform_point3(start)).collect();
        assert_eq!(places.len(), 8);
        assert_eq!(places[0], start);
        let opposite = DVec3::new(2.0 * centre.x - start.x, start.y, 2.0 * centre.z - start.z);
        assert!(places[4].distance(opposite) < 1e-12, "{}", places[4]);
        for (k, p) in places.iter().enumerate() {
            assert!((p.distance(centre) - start.distance(centre)).abs() < 1e-12, "{k}");
            assert!((p.y - start.y).abs() < 1e-12, "{k}");
            // Equal steps: the next is as far as the last.
            assert!((p.distance(places[(k + 1) % 8]) - start.distance(places[1])).abs() < 1e-12, "{k}");
        }
    }
}
