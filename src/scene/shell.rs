//! Closed surfaces: their volume, and whether a point lies inside.

use glam::{DVec3, Vec3};

/// A closed surface, wound alike everywhere.
pub(crate) struct Shell {
    triangles: Vec<[DVec3; 3]>,
    low: DVec3,
    high: DVec3,
}

impl Shell {
    pub(crate) fn new(triangles: impl Iterator<Item = [Vec3; 3]>) -> Shell {
        let triangles: Vec<[DVec3; 3]> = triangles.map(|t| t.map(Vec3::as_dvec3)).collect();
        let low = triangles.iter().flatten().fold(DVec3::INFINITY, |m, p| m.min(*p));
        let high = triangles.iter().flatten().fold(DVec3::NEG_INFINITY, |m, p| m.max(*p));
        Shell { triangles, low, high }
    }

    /// Enclosed volume; positive if the normals point outwards (divergence theorem).
    pub(crate) fn volume(&self) -> f64 {
        let centre = 0.5 * (self.low + self.high);
        let six: f64 = self.triangles.iter().map(|[a, b, c]| (*a - centre).dot((*b - centre).cross(*c - centre))).sum();
        six / 6.0
    }

    /// Whether the winding number of the surface around `p` is not 0: signed crossings of a ray towards +x.
    pub(crate) fn contains(&self, p: DVec3) -> bool {
        if p.cmplt(self.low).any() || p.cmpgt(self.high).any() {
            return false;
        }
        self.triangles.iter().map(|t| crossing(p, t)).sum::<i32>() != 0
    }
}

/// 1 or -1 if the ray from `p` towards +x leaves or enters through the triangle, else 0.
///
/// An edge belongs to one of the two triangles at it: it is tested with its ends in a fixed order, half open.
fn crossing(p: DVec3, t: &[DVec3; 3]) -> i32 {
    if t.iter().all(|v| v.x < p.x) {
        return 0;
    }
    let mut inside = false;
    for k in 0..3 {
        let (mut a, mut b) = (t[k], t[(k + 1) % 3]);
        if (a.z, a.y) > (b.z, b.y) {
            std::mem::swap(&mut a, &mut b);
        }
        if (a.z <= p.z) != (b.z <= p.z) && (b.y - a.y) * (p.z - a.z) > (p.y - a.y) * (b.z - a.z) {
            inside = !inside;
        }
    }
    let normal = (t[1] - t[0]).cross(t[2] - t[0]);
    if !inside || normal.x == 0.0 {
        return 0;
    }
    // The plane's x at p's y and z.
    let x = t[0].x + (normal.y * (t[0].y - p.y) + normal.z * (t[0].z - p.z)) / normal.x;
    if x > p.x { normal.x.signum() as i32 } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The unit cube, outward normals.
    fn cube() -> Vec<[Vec3; 3]> {
        let v = |i: u32| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32);
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
            .iter()
            .flat_map(|q| [[v(q[0]), v(q[1]), v(q[2])], [v(q[0]), v(q[2]), v(q[3])]])
            .collect()
    }

    #[test]
    fn a_cube_has_its_volume_and_contains_its_inside() {
        let shell = Shell::new(cube().into_iter());
        assert!((shell.volume() - 1.0).abs() < 1e-15);
        // The ray from the centre crosses the diagonal of the far face.
        assert!(shell.contains(DVec3::splat(0.5)));
        for p in [[0.1, 0.9, 0.3], [0.5, 0.5, 0.25], [0.999, 0.001, 0.5]] {
            assert!(shell.contains(p.into()), "{p:?}");
        }
        for p in [[-0.1, 0.5, 0.5], [1.1, 0.5, 0.5], [0.5, 1.1, 0.5], [-0.1, 0.3, 0.3]] {
            assert!(!shell.contains(p.into()), "{p:?}");
        }
    }
}
