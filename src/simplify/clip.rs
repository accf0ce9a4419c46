//! Step 1 of the paper: source polygons are split by the voxels.

use glam::{DVec2, DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::grid::Grid;
use crate::{Scene, lxt::Array};

/// Marks the absence of a patch.
pub const NO_PATCH: u32 = u32::MAX;

/// Convex pieces of triangles, each inside one voxel; sorted by triangle.
#[derive(Clone, Debug, Default)]
pub struct Fragments {
    /// Scene triangle of each fragment.
    pub triangle: Array<u32>,
    /// Raster position of its voxel.
    pub voxel: Array<u64>,
    /// Where its corners begin in `uv`; one more entry than fragments.
    pub start: Array<u32>,
    /// Corners as barycentric weights of the triangle's second and third vertex, in the winding of the triangle.
    pub uv: Array<Vec2>,
    /// Patch of the front and of the back; [`NO_PATCH`] where that side is the inside of an object.
    pub patch: Array<[u32; 2]>,
}

impl Fragments {
    /// Number of fragments.
    pub fn len(&self) -> usize {
        self.triangle.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.triangle.is_empty()
    }

    /// Corners of fragment `f` in barycentric weights.
    pub fn uv(&self, f: usize) -> &[Vec2] {
        &self.uv[self.start[f] as usize..self.start[f + 1] as usize]
    }

    /// Area of fragment `f` of a triangle with these corners, local units squared.
    pub fn area(&self, f: usize, corners: &[Vec3; 3]) -> f64 {
        let [a, b, c] = corners.map(Vec3::as_dvec3);
        // |(b - a) x (c - a)| is twice the triangle's area; the unit triangle of barycentric weights has area 1/2.
        (b - a).cross(c - a).length() * uv_area(self.uv(f))
    }

    /// Adds one fragment; `uv` has at least three corners.
    pub fn push(&mut self, triangle: u32, voxel: u64, uv: impl IntoIterator<Item = Vec2>) {
        if self.start.is_empty() {
            self.start.own().push(0);
        }
        self.triangle.own().push(triangle);
        self.voxel.own().push(voxel);
        self.uv.own().extend(uv);
        self.start.own().push(self.uv.len() as u32);
        self.patch.own().push([NO_PATCH; 2]);
    }

    /// The fragments of all `parts`, one part after the other.
    pub(super) fn join(parts: &[Fragments]) -> Fragments {
        let (count, corners) = parts.iter().fold((0, 0), |sum, part| (sum.0 + part.len(), sum.1 + part.uv.len()));
        let mut start = Vec::with_capacity(count + 1);
        let (mut triangle, mut voxel) = (Vec::with_capacity(count), Vec::with_capacity(count));
        let (mut uv, mut patch) = (Vec::with_capacity(corners), Vec::with_capacity(count));
        start.push(0);
        for part in parts {
            let before = uv.len() as u32;
            start.extend(part.start.iter().skip(1).map(|end| before + end));
            triangle.extend_from_slice(&part.triangle);
            voxel.extend_from_slice(&part.voxel);
            uv.extend_from_slice(&part.uv);
            patch.extend_from_slice(&part.patch);
        }
        let [start, triangle] = [start, triangle].map(Array::from);
        Fragments { triangle, voxel: voxel.into(), start, uv: uv.into(), patch: patch.into() }
    }
}

/// Position of barycentric weights `uv` on the triangle with `corners`.
pub fn point_at(corners: &[Vec3; 3], uv: Vec2) -> Vec3 {
    corners[0] + (corners[1] - corners[0]) * uv.x + (corners[2] - corners[0]) * uv.y
}

/// Barycentric weights of the foot of `p` on the plane of the triangle.
pub fn uv_of(corners: &[Vec3; 3], p: Vec3) -> Vec2 {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    let (e1, e2, d) = (b - a, c - a, p.as_dvec3() - a);
    let n = e1.cross(e2);
    DVec2::new(d.cross(e2).dot(n), e1.cross(d).dot(n)).as_vec2() / n.length_squared() as f32
}

/// Smallest signed distance of `p` to the lines of the polygon's edges, positive inside.
pub fn depth_inside(polygon: &[Vec2], p: Vec2) -> f32 {
    let mut depth = f32::INFINITY;
    for (i, &a) in polygon.iter().enumerate() {
        let edge = polygon[(i + 1) % polygon.len()] - a;
        let length = edge.length();
        if length > 0.0 {
            depth = depth.min(edge.perp_dot(p - a) / length);
        }
    }
    depth
}

/// Signed area of a polygon in the plane of barycentric weights.
pub fn uv_area(uv: &[Vec2]) -> f64 {
    let origin = uv[0].as_dvec2();
    let edge = |p: Vec2| p.as_dvec2() - origin;
    0.5 * uv[1..].windows(2).map(|w| edge(w[0]).perp_dot(edge(w[1]))).sum::<f64>()
}

/// Centroid of a polygon in the plane of barycentric weights; the mean of the corners if its area is zero.
pub fn uv_centroid(uv: &[Vec2]) -> Vec2 {
    let origin = uv[0].as_dvec2();
    let (mut area, mut sum) = (0.0, DVec2::ZERO);
    for w in uv[1..].windows(2) {
        let (a, b) = (w[0].as_dvec2() - origin, w[1].as_dvec2() - origin);
        let c = a.perp_dot(b);
        area += c;
        sum += (a + b) * c / 3.0;
    }
    if area.abs() > 0.0 { (origin + sum / area).as_vec2() } else { uv.iter().sum::<Vec2>() / uv.len() as f32 }
}

/// Splits every triangle by the planes of the grid. The areas of the fragments sum to those of the triangles up to
/// rounding (1e-6 relative).
pub fn clip(scene: &Scene, grid: &Grid) -> Fragments {
    // Joined in order: the same fragments for any number of threads.
    let chunks: Vec<Fragments> = (0..scene.triangles.len())
        .collect::<Vec<_>>()
        .par_chunks(share(scene.triangles.len()))
        .with_max_len(1)
        .map(|triangles| {
            let mut out = Fragments::default();
            let mut scratch = Scratch::default();
            for &t in triangles {
                clip_triangle(scene, grid, t, &mut scratch, &mut out);
            }
            out
        })
        .collect();
    Fragments::join(&chunks)
}

/// Triangles, of so many, that make a unit of parallel work: few where there are few, since these are large.
pub(super) fn share(triangles: usize) -> usize {
    (triangles / 64).clamp(1, 512)
}

/// A corner of a polygon that is being cut: position in voxel units, barycentric weights.
#[derive(Clone, Copy, Debug, Default)]
struct Corner {
    p: DVec3,
    uv: DVec2,
}

#[derive(Default)]
struct Scratch {
    slabs: Vec<Vec<Corner>>,
    columns: Vec<Vec<Corner>>,
    cells: Vec<Vec<Corner>>,
}

/// Fragments below this share of min(voxel face, triangle) are rounding dust on the planes of the grid.
const DUST: f64 = 1e-8;

fn clip_triangle(scene: &Scene, grid: &Grid, t: usize, scratch: &mut Scratch, out: &mut Fragments) {
    let corners = scene.corners_of(t).map(|p| (p.as_dvec3() - grid.origin) / grid.voxel_size);
    let uvs = [DVec2::ZERO, DVec2::X, DVec2::Y];
    let polygon: Vec<Corner> = (0..3).map(|k| Corner { p: corners[k], uv: uvs[k] }).collect();
    let area = 0.5 * (corners[1] - corners[0]).cross(corners[2] - corners[0]).length();
    let smallest = DUST * area.min(1.0);
    let before = out.len();
    let mut largest: Option<(f64, u64, Vec<Corner>)> = None;

    slice(&polygon, 0, &mut scratch.slabs);
    for slab in &scratch.slabs {
        slice(slab, 1, &mut scratch.columns);
        for column in &scratch.columns {
            slice(column, 2, &mut scratch.cells);
            for cell in &scratch.cells {
                let voxel = cell_of(cell, grid);
                let cell_area = 2.0 * area * polygon_uv_area(cell);
                if cell_area > smallest {
                    out.push(t as u32, voxel, cell.iter().map(|c| c.uv.as_vec2()));
                } else if out.len() == before && largest.as_ref().is_none_or(|l| cell_area > l.0) {
                    largest = Some((cell_area, voxel, cell.clone()));
                }
            }
        }
    }
    // Every triangle keeps at least one fragment, so that every hit has a patch.
    if out.len() == before {
        let voxel = largest.map_or_else(|| cell_of(&polygon, grid), |l| l.1);
        out.push(t as u32, voxel, uvs.map(|uv| uv.as_vec2()));
    }
}

/// The voxel that holds the middle of a polygon.
fn cell_of(polygon: &[Corner], grid: &Grid) -> u64 {
    let middle = polygon.iter().map(|c| c.p).sum::<DVec3>() / polygon.len() as f64;
    grid.raster(std::array::from_fn(|k| (middle[k].max(0.0) as u32).min(grid.dims[k] - 1)))
}

fn polygon_uv_area(polygon: &[Corner]) -> f64 {
    let edge = |c: &Corner| c.uv - polygon[0].uv;
    0.5 * polygon[1..].windows(2).map(|w| edge(&w[0]).perp_dot(edge(&w[1]))).sum::<f64>().abs()
}

/// Cuts a convex polygon by the integer planes of `axis`.
fn slice(polygon: &[Corner], axis: usize, out: &mut Vec<Vec<Corner>>) {
    out.clear();
    let (lo, hi) =
        polygon.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), c| (lo.min(c.p[axis]), hi.max(c.p[axis])));
    let mut rest = polygon.to_vec();
    let mut plane = lo.floor() + 1.0;
    while plane < hi && rest.len() >= 3 {
        let (below, above) = cut(&rest, axis, plane);
        if below.len() >= 3 {
            out.push(below);
        }
        rest = above;
        plane += 1.0;
    }
    if rest.len() >= 3 {
        out.push(rest);
    }
}

/// Sutherland & Hodgman 1974, both halves at once.
fn cut(polygon: &[Corner], axis: usize, plane: f64) -> (Vec<Corner>, Vec<Corner>) {
    let (mut below, mut above) = (Vec::with_capacity(8), Vec::with_capacity(8));
    for (i, a) in polygon.iter().enumerate() {
        let b = &polygon[(i + 1) % polygon.len()];
        let (da, db) = (a.p[axis] - plane, b.p[axis] - plane);
        if da <= 0.0 {
            below.push(*a);
        }
        if da >= 0.0 {
            above.push(*a);
        }
        if da * db < 0.0 {
            // From the lower corner, so that both triangles of an edge compute the same point.
            let (low, high, s) = if da < db { (a, b, da / (da - db)) } else { (b, a, db / (db - da)) };
            let mut corner = Corner { p: low.p.lerp(high.p, s), uv: low.uv.lerp(high.uv, s) };
            corner.p[axis] = plane;
            below.push(corner);
            above.push(corner);
        }
    }
    (below, above)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_is_positive_inside_and_negative_outside() {
        let square = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
        assert_eq!(depth_inside(&square, Vec2::new(0.25, 0.5)), 0.25);
        assert_eq!(depth_inside(&square, Vec2::new(1.5, 0.5)), -0.5);
    }

    #[test]
    fn barycentric_weights_round_trip() {
        let corners = [Vec3::new(0.1, 0.2, 0.3), Vec3::new(0.4, -0.2, 0.1), Vec3::new(-0.3, 0.1, 0.2)];
        let uv = Vec2::new(0.3, 0.2);
        assert!((uv_of(&corners, point_at(&corners, uv)) - uv).length() < 1e-6);
    }
}
