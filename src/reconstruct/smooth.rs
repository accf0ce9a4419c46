//! Local linear least squares over the patches that a point sees on its own surface.

use glam::{DMat3, DVec2, DVec3, Vec3};

use super::{Field, Neighbour, nearest4};
use crate::{
    sampling,
    scene::SurfacePoint,
    simplify::{LIFT, UNLIKE, clear_heights},
    trace::{Hit, RayBatch},
};

/// Patches within this many voxels take part.
const RADIUS: f32 = 1.5;
/// Patches of this area, in voxel faces, have half the weight of large ones.
const DUST: f32 = 0.05;
/// How far, in voxels, a patch may stand off the smooth surface through the point.
const STEP: f32 = 0.25;
/// Most neighbours of a point: those of the largest weight. A plane has 7 to 9 within the radius.
pub const MOST: usize = 16;

/// Fits are doubtful from here on: 12 % of the points of the Cornell box, 11 % of the curved room, 16 % of two rooms.
const DOUBT: f32 = 0.2;

/// What the patches near a point say.
#[derive(Clone, Copy)]
pub struct Fit {
    /// Irradiance, W/m2.
    pub value: Vec3,
    /// How much the patches differ, in units of the value, plus how far to one side of the point they lie, in voxels:
    /// large at shadow edges, creases and borders. Infinite where there are none.
    pub doubt: f32,
}

impl Fit {
    /// Whether a gather would do better.
    pub fn is_doubtful(&self) -> bool {
        self.doubt > DOUBT
    }
}

/// Where the neighbours of a point end.
struct Run {
    end: usize,
    /// Whether it is known that the point sees all of them.
    clear: bool,
}

/// Fits a plane to the values of the neighbours of every point, and takes its value at the point, kept within what
/// the neighbours say. Points without visible neighbours take the paper's four nearest.
pub fn interpolate(field: &Field, points: &[SurfacePoint]) -> Vec<Fit> {
    let h = field.simplified.grid.voxel_size as f32;
    let (ends, neighbours) = neighbours(field, points);
    let mut begin = 0;
    points
        .iter()
        .zip(ends)
        .map(|(point, end)| {
            let own = &neighbours[begin as usize..end as usize];
            begin = end;
            fit(field, point, own, h)
                .unwrap_or_else(|| Fit { value: nearest4::interpolate(field, point), doubt: f32::INFINITY })
        })
        .collect()
}

/// What [`interpolate`] takes from each neighbour of a point, as (patch, factor) of one point after the other, and where
/// those of each end: the value of the fit is their sum, before it is kept within what they say. The factors sum to 1; there
/// are none where a point is not sound. The field's values are not looked at.
pub fn factors(field: &Field, points: &[SurfacePoint]) -> (Vec<(u32, f32)>, Vec<usize>) {
    let h = field.simplified.grid.voxel_size as f32;
    let (ends, neighbours) = neighbours(field, points);
    let (mut all, mut of_point) = (Vec::with_capacity(neighbours.len()), Vec::with_capacity(points.len()));
    let mut begin = 0;
    for (point, end) in points.iter().zip(ends) {
        let own = &neighbours[begin as usize..end as usize];
        begin = end;
        match plane(field, point, own, h) {
            Some(plane) => {
                let factor = |n: &Neighbour| {
                    let w = n.weight as f64 * plane.at_point.dot(basis(field, point, &plane, n, h));
                    (n.patch, w as f32)
                };
                all.extend(own.iter().filter(|n| n.weight > 0.0).map(factor));
            }
            None => all.extend(nearest4::factors(field, point)),
        }
        of_point.push(all.len());
    }
    (all, of_point)
}

/// Patches that each point sees on its own surface, and where those of each point end; those that it does not see have
/// no weight.
pub fn neighbours(field: &Field, points: &[SurfacePoint]) -> (Vec<u32>, Vec<Neighbour>) {
    let h = field.simplified.grid.voxel_size as f32;
    let mut neighbours: Vec<Neighbour> = Vec::with_capacity(points.len() * 16);
    let mut ends = Vec::with_capacity(points.len());
    for point in points {
        let clear = match field.stencils.and_then(|stencils| stencils.find(point)) {
            Some(known) => {
                neighbours.extend_from_slice(known);
                true
            }
            None => gather(field, point, h, &mut neighbours),
        };
        ends.push(Run { end: neighbours.len(), clear });
    }
    drop_hidden(field, points, &ends, h, &mut neighbours);
    (ends.iter().map(|run| run.end as u32).collect(), neighbours)
}

/// Known patches that face the same way, lie near and on the same smooth surface; whether nothing can hide them.
fn gather(field: &Field, point: &SurfacePoint, h: f32, out: &mut Vec<Neighbour>) -> bool {
    if !point.is_sound() {
        return false;
    }
    let patches = field.patches();
    let mut clear = field.level.is_known()
        && field.index.all_near(point.position, RADIUS + 2.0 * LIFT, |j| {
            field.level.is_below(j, patches.normal[j], patches.centroid[j] - point.position, point.normal)
        });
    let begin = out.len();
    field.index.within(point.position, RADIUS, |j| {
        let (to, normal) = (patches.centroid[j] - point.position, patches.normal[j]);
        let distance = to.length() / (RADIUS * h);
        if !field.known[j] || distance >= 1.0 || normal.dot(point.normal) < field.cos_threshold {
            return;
        }
        // Zero between any two points of a plane or sphere; the height of a step between parallel planes.
        let step = to.dot((normal + point.normal).normalize()).abs() / (STEP * h);
        if step >= 1.0 {
            return;
        }
        // Dust in the corners of rooms sees less clearly than whole patches, and stands for less.
        let share = patches.area[j] / (patches.area[j] + DUST * h * h);
        let weight = (1.0 - distance * distance).powi(2) * (1.0 - step * step).powi(2) * share;
        clear = clear && field.level.is_level(to, point.normal);
        out.push(Neighbour { patch: j as u32, weight });
    });
    let own = &mut out[begin..];
    if own.len() > MOST {
        own.select_nth_unstable_by(MOST, |a, b| b.weight.total_cmp(&a.weight).then(a.patch.cmp(&b.patch)));
        own[..MOST].sort_unstable_by_key(|n| n.patch);
        out.truncate(begin + MOST);
    }
    clear
}

/// Takes the weight from neighbours that the point does not see. Surfaces that face like the point do not block, or
/// convex surfaces would hide their own. Rays go upwards: what parts two layers then turns its underside to them.
fn drop_hidden(field: &Field, points: &[SurfacePoint], ends: &[Run], h: f32, neighbours: &mut [Neighbour]) {
    let patches = field.patches();
    let mut rays = RayBatch::with_capacity(neighbours.len());
    // Point and neighbour of every ray.
    let mut of_ray = Vec::with_capacity(neighbours.len());
    let asking = points.iter().zip(ends).filter(|(_, run)| !run.clear).map(|(p, _)| (p.position, p.normal));
    let mut heights = clear_heights(field.tracer, asking, LIFT * h).into_iter();
    let mut begin = 0;
    for (i, (point, run)) in points.iter().zip(ends).enumerate() {
        let own = begin..run.end;
        begin = run.end;
        let Some(height) = (if run.clear { None } else { heights.next() }) else { continue };
        let from = point.position + height * point.normal;
        for k in own {
            let j = neighbours[k].patch as usize;
            let eye = patches.eye[j];
            let rises = (eye - from).dot(point.normal + patches.normal[j]) >= 0.0;
            let (low, high) = if rises { (from, eye) } else { (eye, from) };
            rays.push(low, high - low, 0.0, 1.0);
            of_ray.push((i, k));
        }
    }
    let mut hits = vec![Hit::NONE; rays.len()];
    field.tracer.closest_hits(&rays, &mut hits);
    field.level.count(rays.len(), neighbours.len() - rays.len());
    for (hit, (i, k)) in hits.iter().zip(of_ray).filter(|(hit, _)| hit.is_hit()) {
        let along = field.normals[hit.triangle()].dot(points[i].normal);
        // From inside of an object its surface says nothing.
        let underside = if hit.is_back() { field.two_sided[hit.triangle()] && along > 0.0 } else { along < 0.0 };
        if underside || along.abs() < UNLIKE {
            neighbours[k].weight = 0.0;
        }
    }
}

/// The normal equations of a fit in the tangent plane of a point.
struct Plane {
    tangents: (Vec3, Vec3),
    /// First row of the inverse of the normal matrix: what makes the value at the point of the right-hand side.
    at_point: DVec3,
    /// How far to one side of the point the neighbours lie, in voxels.
    lopsided: f64,
}

/// Weighted linear least squares in the tangent plane; `None` without neighbours.
fn plane(field: &Field, point: &SurfacePoint, neighbours: &[Neighbour], h: f32) -> Option<Plane> {
    let mut plane = Plane { tangents: sampling::frame(point.normal), at_point: DVec3::ZERO, lopsided: 0.0 };
    let mut normal_matrix = DMat3::ZERO;
    for n in neighbours.iter().filter(|n| n.weight > 0.0) {
        let basis = basis(field, point, &plane, n, h);
        normal_matrix += DMat3::from_cols(basis * basis.x, basis * basis.y, basis * basis.z) * n.weight as f64;
    }
    let moment = normal_matrix.x_axis;
    let weights = moment.x;
    if weights <= 1e-6 {
        return None;
    }
    // A weak pull of the slopes to zero: few or collinear neighbours make no wild slopes.
    normal_matrix.y_axis.y += RIDGE * weights;
    normal_matrix.z_axis.z += RIDGE * weights;
    plane.at_point = normal_matrix.inverse().row(0);
    plane.lopsided = DVec2::new(moment.y, moment.z).length() / weights;
    Some(plane)
}

/// One, and where the neighbour lies in the tangent plane, in voxels.
fn basis(field: &Field, point: &SurfacePoint, plane: &Plane, n: &Neighbour, h: f32) -> DVec3 {
    let to = (field.patches().centroid[n.patch as usize] - point.position) / h;
    DVec3::new(1.0, to.dot(plane.tangents.0) as f64, to.dot(plane.tangents.1) as f64)
}

/// The value of the fitted plane at the point, kept within what the neighbours say; `None` without neighbours.
fn fit(field: &Field, point: &SurfacePoint, neighbours: &[Neighbour], h: f32) -> Option<Fit> {
    let plane = plane(field, point, neighbours, h)?;
    let mut right = [DVec3::ZERO; 3];
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for n in neighbours.iter().filter(|n| n.weight > 0.0) {
        let basis = basis(field, point, &plane, n, h);
        let value = field.values[n.patch as usize];
        for c in 0..3 {
            right[c] += basis * (n.weight as f64 * value[c] as f64);
        }
        low = low.min(value);
        high = high.max(value);
    }
    let value = Vec3::from_array(std::array::from_fn(|c| plane.at_point.dot(right[c]) as f32));
    let value = within(value, low, high);
    let (spread, level) = ((high - low).element_sum(), value.element_sum());
    let doubt = plane.lopsided as f32 + if spread > 0.0 { spread / level } else { 0.0 };
    Some(Fit { value, doubt })
}

/// A fitted value kept within what the neighbours say. Half their range beyond them is what a corner of a room asks for.
pub fn within(value: Vec3, low: Vec3, high: Vec3) -> Vec3 {
    let margin = 0.5 * (high - low);
    let value = value.clamp((low - margin).max(Vec3::ZERO), high + margin);
    if value.is_finite() { value } else { low }
}

/// Ridge on the slopes, in units of value per voxel.
const RIDGE: f64 = 0.01;
