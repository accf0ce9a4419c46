//! The emissive triangles of a scene as lamps; two that make a parallelogram become one.

use std::collections::HashMap;

use glam::Vec3;

use super::lamp::{Lamp, Polygon, Shape};
use crate::{Scene, scene::RAY_OFFSET};

/// How far a corner may be from completing a parallelogram: well below the height at which shadow rays end.
const FLATNESS: f32 = 0.25 * RAY_OFFSET;

struct Emitter {
    corners: [Vec3; 3],
    radiance: Vec3,
    both_sides: bool,
}

/// The lamps of those of the scene's triangles that are `asked` for, in their order.
pub(super) fn lamps(scene: &Scene, asked: impl Fn(usize) -> bool) -> Vec<Lamp> {
    let emitters: Vec<Emitter> =
        (0..scene.triangles.len()).filter(|&t| asked(t)).filter_map(|t| emitter(scene, t)).collect();

    let mut by_edge: HashMap<[[u32; 3]; 2], Vec<u32>> = HashMap::new();
    for (i, e) in emitters.iter().enumerate() {
        for k in 0..3 {
            by_edge.entry(edge_key(e.corners[k], e.corners[(k + 1) % 3])).or_default().push(i as u32);
        }
    }

    // Two triangles of a quad get half the samples each; one quad gets them all, better stratified.
    let mut used = vec![false; emitters.len()];
    let mut lamps = Vec::new();
    for (i, e) in emitters.iter().enumerate() {
        if used[i] {
            continue;
        }
        used[i] = true;
        let partner = (0..3).find_map(|k| {
            let neighbours = &by_edge[&edge_key(e.corners[k], e.corners[(k + 1) % 3])];
            neighbours
                .iter()
                .map(|&j| j as usize)
                .filter(|&j| !used[j])
                .find_map(|j| Some((j, quad(e, k, &emitters[j])?)))
        });
        let polygon = match partner {
            Some((j, corners)) => {
                used[j] = true;
                Polygon::new(&corners, e.both_sides)
            }
            None => Polygon::new(&e.corners, e.both_sides),
        };
        lamps.extend(polygon.map(|p| Lamp { shape: Shape::Polygon(p), colour: e.radiance, surface: true }));
    }
    lamps
}

fn emitter(scene: &Scene, t: usize) -> Option<Emitter> {
    let radiance = scene.emission(t);
    let lit = radiance.is_finite() && radiance.max_element() > 0.0 && radiance.min_element() >= 0.0;
    let corners = scene.corners_of(t);
    let both_sides = scene.triangles[t].emits_back;
    (lit && corners.iter().all(|c| c.is_finite())).then_some(Emitter { corners, radiance, both_sides })
}

/// An edge by its end points, whichever way it is walked.
fn edge_key(a: Vec3, b: Vec3) -> [[u32; 3]; 2] {
    // Adding zero makes -0 equal to 0.
    let bits = |p: Vec3| (p + Vec3::ZERO).to_array().map(f32::to_bits);
    let (a, b) = (bits(a), bits(b));
    if a < b { [a, b] } else { [b, a] }
}

/// The parallelogram of `e` and `other`, which share edge `k` of `e`.
fn quad(e: &Emitter, k: usize, other: &Emitter) -> Option<[Vec3; 4]> {
    if e.radiance != other.radiance || e.both_sides != other.both_sides {
        return None;
    }
    let (b, d, a) = (e.corners[k], e.corners[(k + 1) % 3], e.corners[(k + 2) % 3]);
    // The neighbour must walk the shared edge the other way, or it faces away.
    let at = (0..3).find(|&m| other.corners[m] == d && other.corners[(m + 1) % 3] == b)?;
    let c = other.corners[(at + 2) % 3];
    ((b + d - a - c).abs().max_element() <= FLATNESS).then_some([a, b, c, d])
}
