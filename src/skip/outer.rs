//! Surfaces with nothing before them: the outsides of boxes, the undersides of grounds.

use std::collections::HashMap;

use glam::Vec3;
use rayon::prelude::*;

use crate::{
    scene::{RAY_OFFSET, SurfacePoint},
    simplify::{Simplified, normal_of},
    trace::Geometry,
};

/// Supporting planes of a geometry: all of it lies behind them. A ray that leaves such a plane meets nothing.
#[derive(Clone, Debug, Default)]
pub struct Outer {
    /// Height of the plane by the bits of its unit normal.
    planes: HashMap<[u32; 3], f32>,
}

/// How far below its plane a point may lie: rays start twice as far above their point.
const FLAT: f32 = 0.5 * RAY_OFFSET;
/// Most vertices that are compared with planes, in all.
const MOST_WORK: usize = 200_000_000;

impl Outer {
    /// The supporting planes that triangles lie in, on either side; as many as can be found with little work.
    pub fn new(geometry: &Geometry) -> Outer {
        let extremes = extremes(&geometry.positions);
        let before = |n: Vec3, points: &[Vec3], at: f32| points.iter().any(|p| n.dot(*p) > at + FLAT);
        let candidates: Vec<Vec<Vec3>> = geometry
            .triangles
            .par_iter()
            .map(|t| {
                let corners = t.map(|v| geometry.positions[v as usize]);
                let n = normal_of(&corners);
                let lies = |n: &Vec3| *n != Vec3::ZERO && !before(*n, &extremes, n.dot(corners[0]));
                [n, -n].into_iter().filter(lies).collect()
            })
            .collect();
        let mut planes = HashMap::new();
        let mut work = 0;
        for n in candidates.into_iter().flatten() {
            if planes.contains_key(&key(n)) {
                continue;
            }
            work += geometry.positions.len();
            if work > MOST_WORK {
                break;
            }
            let height = geometry.positions.par_iter().map(|p| n.dot(*p)).reduce(|| f32::NEG_INFINITY, f32::max);
            planes.insert(key(n), height);
        }
        Outer { planes }
    }

    /// Whether nothing lies before the surface at `x`.
    pub fn is_clear(&self, x: &SurfacePoint) -> bool {
        self.planes.get(&key(x.normal)).is_some_and(|&height| x.normal.dot(x.position) >= height - FLAT)
    }

    /// Which patches of the geometry nothing lies before.
    pub fn patches(&self, simplified: &Simplified) -> Vec<bool> {
        let clear = |&member: &u32| {
            let corners = simplified.corners(simplified.fragments.triangle[(member >> 1) as usize] as usize);
            let normal = normal_of(&corners) * if member & 1 == 1 { -1.0 } else { 1.0 };
            corners.iter().all(|&position| self.is_clear(&SurfacePoint { position, normal }))
        };
        let patches = &simplified.patches;
        (0..patches.len()).into_par_iter().map(|i| patches.members(i).iter().all(clear)).collect()
    }
}

/// Adding zero makes -0 equal to 0.
fn key(n: Vec3) -> [u32; 3] {
    (n + Vec3::ZERO).to_array().map(f32::to_bits)
}

/// The points farthest along 26 directions: they lie before nearly every plane that something lies before.
fn extremes(points: &[Vec3]) -> Vec<Vec3> {
    let axis = || [-1.0, 0.0, 1.0_f32].into_iter();
    let directions = axis().flat_map(|x| axis().flat_map(move |y| axis().map(move |z| Vec3::new(x, y, z))));
    directions
        .filter(|d| *d != Vec3::ZERO)
        .filter_map(|d| points.iter().copied().max_by(|a, b| d.dot(*a).total_cmp(&d.dot(*b))))
        .collect()
}

#[cfg(test)]
mod tests {
    use glam::Vec3Swizzles;

    use super::*;

    /// The corners of a box of edges `size`, two triangles a face.
    fn cube(low: Vec3, size: f32, geometry: &mut Geometry) {
        let first = geometry.positions.len() as u32;
        let corner = |i: u32| low + size * Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32);
        geometry.positions.extend((0..8).map(corner));
        for [a, b, c, d] in [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]] {
            geometry.triangles.extend([[a, b, c], [a, c, d]].map(|t: [u32; 3]| t.map(|v| v + first)));
        }
    }

    #[test]
    fn the_outside_of_a_box_is_clear_and_nothing_else() {
        let mut geometry = Geometry::default();
        cube(Vec3::splat(-0.5), 1.0, &mut geometry);
        cube(Vec3::splat(-0.2), 0.4, &mut geometry);
        let outer = Outer::new(&geometry);
        for normal in [Vec3::X, -Vec3::X, Vec3::Y, -Vec3::Y, Vec3::Z, -Vec3::Z] {
            let at = |height: f32| SurfacePoint { position: height * normal + 0.1 * normal.yzx(), normal };
            assert!(outer.is_clear(&at(0.5)), "{normal}");
            assert!(!outer.is_clear(&at(0.2)), "{normal}: of the inner box");
            assert!(!outer.is_clear(&at(-0.5)), "{normal}: inside");
        }
        let oblique = Vec3::new(0.6, 0.8, 0.0);
        assert!(!outer.is_clear(&SurfacePoint { position: 9.0 * oblique, normal: oblique }));
    }

    #[test]
    fn one_vertex_before_a_plane_is_enough() {
        let mut geometry = Geometry::default();
        cube(Vec3::splat(-0.5), 1.0, &mut geometry);
        let top = SurfacePoint { position: Vec3::new(0.1, 0.5, 0.1), normal: Vec3::Y };
        assert!(Outer::new(&geometry).is_clear(&top));
        geometry.positions.push(Vec3::new(0.2, 0.5 + 4.0 * RAY_OFFSET, 0.0));
        geometry.triangles.push([0, 1, 8]);
        assert!(!Outer::new(&geometry).is_clear(&top));
    }
}
