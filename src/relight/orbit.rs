//! Lights that go round.

use glam::{DAffine3, DVec3};

use super::Source;
use crate::Scene;

/// The places of a light that goes once round the axis through `centre` along `up`, in `frames` equal steps: the first is
/// `outward` of where it stands. For [`super::Relighter::place`].
pub fn orbit(centre: DVec3, up: DVec3, outward: DVec3, frames: usize) -> impl Iterator<Item = DAffine3> {
    let axis = up.normalize_or(DVec3::Y);
    (0..frames).map(move |k| {
        let start = DAffine3::from_translation(outward);
        if k == 0 {
            // To the bit, so that a first frame where the light stands needs nothing new.
            return start;
        }
        let turn = DAffine3::from_axis_angle(axis, std::f64::consts::TAU * k as f64 / frames as f64);
        DAffine3::from_translation(centre) * turn * DAffine3::from_translation(-centre) * start
    })
}

/// The least radius of an orbit about `up` if none is asked for, as a share of the narrower side of the scene's box.
const LEAST_RADIUS: f64 = 0.25;

/// How far `source` is to be moved, straight away from the axis through `centre` along `up`, so that it goes round at `radius`;
/// without a radius, at its own distance from the axis, but at least a quarter of the scene's narrower side. Zero for suns and
/// skies, which stand nowhere.
pub fn outward(scene: &Scene, source: &Source, [centre, up]: [DVec3; 2], radius: Option<f64>) -> DVec3 {
    let Some(middle) = source.middle(scene) else { return DVec3::ZERO };
    let axis = up.normalize_or(DVec3::Y);
    let (low, high) = bounds(scene);
    let from_axis = (middle - centre).reject_from_normalized(axis);
    let distance = from_axis.length();
    let along = axis.abs().max_position();
    let narrower = (0..3).filter(|&k| k != along).map(|k| (high - low)[k]).fold(f64::INFINITY, f64::min);
    let least = if narrower.is_finite() { LEAST_RADIUS * narrower } else { 0.0 };
    let radius = radius.unwrap_or(distance.max(least));
    // Where it hangs on the axis but for rounding, any way out will do.
    let way = if distance > 1e-3 * radius { from_axis / distance } else { axis.any_orthonormal_vector() };
    (radius - distance) * way
}

/// The middle of the box around the surfaces of a scene, world coordinates.
pub fn middle(scene: &Scene) -> DVec3 {
    let (low, high) = bounds(scene);
    if low.is_finite() && high.is_finite() { 0.5 * (low + high) } else { scene.frame.origin }
}

/// The box around the surfaces of a scene, world coordinates.
fn bounds(scene: &Scene) -> (DVec3, DVec3) {
    let corners = || scene.positions.iter().map(|p| scene.frame.to_world(*p));
    (corners().fold(DVec3::INFINITY, DVec3::min), corners().fold(DVec3::NEG_INFINITY, DVec3::max))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_orbit_comes_round_at_equal_distance_and_height() {
        let (centre, start) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 7.0, -1.0));
        let places: Vec<DVec3> =
            orbit(centre, 2.0 * DVec3::Y, DVec3::ZERO, 8).map(|p| p.transform_point3(start)).collect();
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

    #[test]
    fn a_light_near_the_axis_is_moved_out_and_others_stay() {
        let scene = crate::scene::load(std::path::Path::new("scenes/cornell.toml"), &Default::default()).unwrap().0;
        let lamp = Source::of_material(
            scene.triangles.iter().find(|t| scene.materials[t.material as usize].emission.x > 0.0).unwrap().material,
            &scene,
        );
        let (centre, up) = (middle(&scene), DVec3::Y);
        let at = lamp.middle(&scene).unwrap();
        let radius = |out: DVec3| (at + out - centre).reject_from_normalized(up).length();
        // The room is 556 wide and 559.2 deep.
        let out = outward(&scene, &lamp, [centre, up], None);
        assert!((radius(out) - 0.25 * 556.0).abs() < 1.0 && out.y.abs() < 1e-9, "{out}");
        assert!((radius(outward(&scene, &lamp, [centre, up], Some(50.0))) - 50.0).abs() < 1e-6);
        // About an axis far away it keeps its distance.
        assert!(outward(&scene, &lamp, [centre + 1000.0 * DVec3::X, up], None).length() < 1e-6);
        let sun = crate::scene::Light::Sun { direction: glam::Vec3::NEG_Y, irradiance: glam::Vec3::ONE };
        assert_eq!(outward(&scene, &Source::of_scene(0, &sun, &scene), [centre, up], Some(9.0)), DVec3::ZERO);
    }
}
