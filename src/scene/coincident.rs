//! Surfaces that lie exactly on other surfaces.

use glam::{DVec3, Vec3};

use super::{Triangle, weld};

/// Marks triangles that coincide with others, so that no surface counts twice; also returns how many of them face the
/// other way than what stays.
///
/// Found are triangles of the same three corners, and pairs of coplanar triangles that make the same convex
/// quadrilateral cut along the other diagonal. Of what coincides the first stays; but an emitting surface replaces a
/// dark one of the same winding: a lamp drawn onto a ceiling shall not be lost.
pub(crate) fn find(
    positions: &[Vec3],
    triangles: &[Triangle],
    emits: impl Fn(&Triangle) -> bool,
) -> (Vec<bool>, usize) {
    let welded = weld::exact(positions);
    let corners: Vec<[u32; 3]> = triangles.iter().map(|t| t.vertices.map(|v| welded[v as usize])).collect();
    let normals: Vec<DVec3> = (triangles.iter())
        .map(|t| {
            let [a, b, c] = t.vertices.map(|v| positions[v as usize].as_dvec3());
            (b - a).cross(c - a).normalize()
        })
        .collect();
    let mut marks = Marks { drop: vec![false; triangles.len()], opposite: 0 };
    let emits: Vec<bool> = triangles.iter().map(emits).collect();

    let mut keys: Vec<([u32; 3], [u32; 1])> = corners.iter().zip(0..).map(|(c, t)| (sorted(*c), [t])).collect();
    keys.sort_unstable();
    marks.groups(&keys, &normals, &emits);

    let mut quads = quadrilaterals(&corners, &normals, &marks.drop, positions, triangles);
    quads.sort_unstable();
    marks.groups(&quads, &normals, &emits);
    (marks.drop, marks.opposite)
}

struct Marks {
    drop: Vec<bool>,
    opposite: usize,
}

impl Marks {
    /// Keeps one member of every group of equal keys; `members` are sorted by key, then triangle.
    fn groups<K: PartialEq, const N: usize>(&mut self, members: &[(K, [u32; N])], normals: &[DVec3], emits: &[bool]) {
        for group in members.chunk_by(|a, b| a.0 == b.0).filter(|g| g.len() > 1) {
            let normal = |m: &[u32; N]| normals[m[0] as usize];
            let free: Vec<[u32; N]> =
                group.iter().map(|g| g.1).filter(|m| m.iter().all(|&t| !self.drop[t as usize])).collect();
            let Some(first) = free.first() else { continue };
            let lamp = |m: &&[u32; N]| m.iter().all(|&t| emits[t as usize]) && normal(m).dot(normal(first)) > 0.0;
            let keep = *free.iter().find(lamp).unwrap_or(first);
            for member in free.iter().filter(|m| m.iter().all(|t| !keep.contains(t))) {
                for &t in member {
                    self.drop[t as usize] = true;
                    self.opposite += usize::from(normals[t as usize].dot(normal(&keep)) < 0.0);
                }
            }
        }
    }
}

/// Convex quadrilaterals of two coplanar triangles, by their sorted corners.
fn quadrilaterals(
    corners: &[[u32; 3]],
    normals: &[DVec3],
    drop: &[bool],
    positions: &[Vec3],
    triangles: &[Triangle],
) -> Vec<([u32; 4], [u32; 2])> {
    // (edge, triangle, number of the corner across)
    let mut edges: Vec<([u32; 2], u32, u8)> = Vec::with_capacity(3 * corners.len());
    for (t, c) in corners.iter().enumerate().filter(|(t, _)| !drop[*t]) {
        for k in 0..3 {
            let (a, b) = (c[(k + 1) % 3], c[(k + 2) % 3]);
            edges.push(([a.min(b), a.max(b)], t as u32, k as u8));
        }
    }
    edges.sort_unstable();
    let mut quads = Vec::new();
    for fan in edges.chunk_by(|a, b| a.0 == b.0) {
        for (i, &(edge, t, k)) in fan.iter().enumerate() {
            for &(_, s, l) in &fan[i + 1..] {
                if normals[t as usize].dot(normals[s as usize]) < 1.0 - 1e-10 {
                    continue;
                }
                let (apex_t, apex_s) = (corners[t as usize][k as usize], corners[s as usize][l as usize]);
                let at = |t: u32, k: usize| positions[triangles[t as usize].vertices[k % 3] as usize].as_dvec3();
                let (p, q) = (at(t, k as usize), at(s, l as usize));
                let (a, b) = (at(t, k as usize + 1), at(t, k as usize + 2));
                // Convex if the ends of the shared edge lie on both sides of the other diagonal.
                let side = |x: DVec3| (q - p).cross(x - p).dot(normals[t as usize]);
                if side(a) * side(b) < 0.0 {
                    let mut key = [edge[0], edge[1], apex_t, apex_s];
                    key.sort_unstable();
                    quads.push((key, [t.min(s), t.max(s)]));
                }
            }
        }
    }
    quads
}

fn sorted(mut c: [u32; 3]) -> [u32; 3] {
    c.sort_unstable();
    c
}
