//! Very many small senders, and what they give in full view.
//!
//! What all of them give is summed up one by one, several to an instruction: a sender from afar is a disc of its area, E = B cos
//! cos' A / (pi r^2 + A) (exact over the middle of a disc; Baum, Rushmeier & Winget 1989 tell how wrong it is nearby), one nearby
//! is its polygons by Lambert's formula.
#![allow(clippy::needless_range_loop)] // Loops over lanes step through several arrays at once.

use std::f32::consts::PI;

use glam::Vec3;
use multiversion::multiversion;

use super::{
    LightSet, bright,
    estimate::CUT,
    lamp::{Lamp, Polygon, Shape},
    lanes::{Block, NONE, WIDTH, load},
};
use crate::{scene::SurfacePoint, simplify::Simplified};

/// A sender within so many of its radii is looked at polygon by polygon. Of what lies farther the light of a disc is off by at
/// most 10/3 (radius / distance)^2 of what it gives face to face, either way: 1 % is left over a hundred squares (test).
pub(super) const NEAR: f32 = 4.0;

/// Patches that send light, in whole blocks: the last ones have no area.
pub(crate) struct Crowd {
    /// Centroid.
    place: [Vec<f32>; 3],
    normal: [Vec<f32>; 3],
    area: Vec<f32>,
    /// Square of the distance within which it is near.
    near: Vec<f32>,
    /// Exitance, W/m2.
    pub(super) colour: [Vec<f32>; 3],
    /// Their polygons, and where those of each sender begin; one more entry than senders.
    polygons: Vec<Lamp>,
    first: Vec<u32>,
}

impl Crowd {
    /// Of `patches` that send `exitance`, W/m2. Patches without area are left out.
    pub fn new(simplified: &Simplified, patches: &[u32], exitance: impl Fn(u32) -> Vec3) -> Crowd {
        let polygons = |i| bright::outlines(simplified, i).iter().filter_map(|o| Polygon::new(o, false)).collect();
        Crowd::of(patches.iter().map(|&i| (polygons(i), exitance(i))))
    }

    /// Of the polygons of `lights`, each a sender; none where they are so few that [`irradiance`](super::irradiance()) looks at
    /// each, or not polygons alone.
    pub fn of_polygons(lights: &LightSet) -> Option<Crowd> {
        let sender = |lamp: &Lamp| Some((vec![lamp.polygon()?.clone()], PI * lamp.colour));
        (lights.polygons && lights.lamps.len() > CUT).then(|| Crowd::of(lights.lamps.iter().filter_map(sender)))
    }

    /// Of senders made of polygons.
    pub(super) fn of(senders: impl Iterator<Item = (Vec<Polygon>, Vec3)>) -> Crowd {
        let mut crowd = Crowd {
            place: Default::default(),
            normal: Default::default(),
            area: Vec::new(),
            near: Vec::new(),
            colour: Default::default(),
            polygons: Vec::new(),
            first: vec![0],
        };
        senders.for_each(|(polygons, exitance)| crowd.push(polygons, exitance));
        let whole = crowd.area.len().next_multiple_of(WIDTH);
        let Crowd { place, normal, area, near, colour, .. } = &mut crowd;
        for column in place.iter_mut().chain(normal).chain(colour).chain([area, near]) {
            column.resize(whole, 0.0);
        }
        crowd
    }

    /// Adds a sender made of `polygons`.
    fn push(&mut self, polygons: Vec<Polygon>, exitance: Vec3) {
        let begin = self.polygons.len();
        let lamp = |p| Lamp { shape: Shape::Polygon(p), colour: Vec3::ONE, surface: true };
        self.polygons.extend(polygons.into_iter().map(lamp));
        let own = || self.polygons[begin..].iter().filter_map(Lamp::polygon);
        let area: f32 = own().map(|p| p.area).sum();
        if !(area > 0.0 && exitance.is_finite()) {
            return self.polygons.truncate(begin);
        }
        let middle = |p: &Polygon| p.corners[..p.count].iter().sum::<Vec3>() / p.count as f32;
        let centroid = own().map(|p| p.area * middle(p)).sum::<Vec3>() / area;
        let normal = own().map(|p| p.area * p.normal).sum::<Vec3>().normalize_or_zero();
        let radius = own().flat_map(|p| p.corners).map(|c| c.distance(centroid)).fold(0.0, f32::max);
        for (column, value) in self.place.iter_mut().zip(centroid.to_array()) {
            column.push(value);
        }
        for (column, value) in self.normal.iter_mut().zip(normal.to_array()) {
            column.push(value);
        }
        for (column, value) in self.colour.iter_mut().zip(exitance.to_array()) {
            column.push(value);
        }
        self.area.push(area);
        self.near.push((NEAR * radius).powi(2));
        self.first.push(self.polygons.len() as u32);
    }

    /// What sender `j` gives to `x` in full view, by unit exitance, from nearby.
    #[cold]
    fn nearby(&self, j: usize, x: &SurfacePoint) -> f32 {
        let own = &self.polygons[self.first[j] as usize..self.first[j + 1] as usize];
        own.iter().map(|lamp| lamp.unshadowed(x)).sum::<f64>() as f32 / PI
    }

    /// A point of sender `j`, with the normal there, by numbers in [0, 1): `which` chooses the polygon.
    pub(super) fn point(&self, j: usize, which: f32, [u, v]: [f32; 2]) -> Option<(Vec3, Vec3)> {
        let mut left = which * self.area[j];
        let own = &self.polygons[self.first[j] as usize..self.first[j + 1] as usize];
        let mut found = None;
        for p in own.iter().filter_map(Lamp::polygon) {
            found = Some(p);
            left -= p.area;
            if left < 0.0 {
                break;
            }
        }
        found.map(|p| (p.point(u, v), p.normal))
    }
}

/// What all senders give to a receiver in full view: those that are near to the mean over `points`, others to their middle.
/// `given` tells the sum of the bands of each, `blocks` of each block.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
pub(super) fn give(crowd: &Crowd, points: &[SurfacePoint], given: &mut Vec<f32>, blocks: &mut Vec<f32>) -> Vec3 {
    given.resize(crowd.area.len(), 0.0);
    blocks.clear();
    let share = 1.0 / points.len() as f32;
    let p = share * points.iter().map(|x| x.position).sum::<Vec3>();
    let n = share * points.iter().map(|x| x.normal).sum::<Vec3>();
    let mut sums = [NONE; 3];
    for at in (0..crowd.area.len()).step_by(WIDTH) {
        let [px, py, pz] = load([&crowd.place[0], &crowd.place[1], &crowd.place[2]], at);
        let [nx, ny, nz] = load([&crowd.normal[0], &crowd.normal[1], &crowd.normal[2]], at);
        let [area, near] = load([&crowd.area, &crowd.near], at);
        let [red, green, blue] = load([&crowd.colour[0], &crowd.colour[1], &crowd.colour[2]], at);
        let (mut form, mut d2s) = (NONE, NONE);
        for i in 0..WIDTH {
            let (dx, dy, dz) = (px[i] - p.x, py[i] - p.y, pz[i] - p.z);
            let d2 = dx * dx + dy * dy + dz * dz;
            let up = dx * n.x + dy * n.y + dz * n.z;
            let down = -(dx * nx[i] + dy * ny[i] + dz * nz[i]);
            let (up, down) = (if up > 0.0 { up } else { 0.0 }, if down > 0.0 { down } else { 0.0 });
            let under = d2 * (PI * d2 + area[i]);
            form[i] = up * down * area[i] / if under > f32::MIN_POSITIVE { under } else { f32::MIN_POSITIVE };
            d2s[i] = d2 - near[i];
        }
        let mut nearest = 0.0;
        for i in 0..WIDTH {
            nearest = if d2s[i] < nearest { d2s[i] } else { nearest };
        }
        if nearest < 0.0 {
            for i in (0..WIDTH).filter(|&i| d2s[i] < 0.0) {
                form[i] = share * points.iter().map(|x| crowd.nearby(at + i, x)).sum::<f32>();
            }
        }
        let mut all = NONE;
        for i in 0..WIDTH {
            let (r, g, b) = (form[i] * red[i], form[i] * green[i], form[i] * blue[i]);
            sums[0][i] += r;
            sums[1][i] += g;
            sums[2][i] += b;
            all[i] = r + g + b;
        }
        given[at..at + WIDTH].copy_from_slice(&all);
        blocks.push(total(&all));
    }
    Vec3::new(total(&sums[0]), total(&sums[1]), total(&sums[2]))
}

/// The sum of a block, by halves.
#[inline(always)]
fn total(block: &Block) -> f32 {
    let mut sum = *block;
    let mut half = WIDTH / 2;
    while half > 0 {
        for i in 0..half {
            sum[i] += sum[i + half];
        }
        half /= 2;
    }
    sum[0]
}
