//! Error of light that patches carry.

use glam::Vec3;
use rayon::prelude::*;

use super::{Variance, chosen, coarse::Coarse, local::Local};
use crate::{
    bake::Bake,
    output::tonemap::luminance,
    reconstruct, sampling,
    scene::SurfacePoint,
    trace::{Hit, RayBatch},
    transfer::{self, Emitter, PointSets},
};

/// A light that patches send each other by form factors.
pub struct Field<'a> {
    /// Irradiance of the patches, W/m2.
    pub received: &'a [Vec3],
    /// Radiosity of the patches that it came from, W/m2.
    pub sent: &'a [Vec3],
    /// Whether what is received is sent on.
    pub reflects: bool,
}

/// Share of the rows that are cast again.
const SHARE: f64 = 1.0 / 16.0;
/// Rows that are cast again at least, where there are as many.
const LEAST: usize = 1024;
/// Number of the independent set of rays of a row.
const AGAIN: u64 = 0x1_0000;
/// Purpose words of random bits.
const CHOICE: u64 = 0x726f_7773;
const SIGNS: u64 = 0x7369_676e;
/// Discretisation errors fall about as this power of the voxel size: between 0.9 and 1.4 from grid 16 to 64 on the Cornell
/// box, a room with curved surfaces and two rooms with a door.
const ORDER: f64 = 1.25;
/// Added to white noise, because light is never negative.
const LIFT: f32 = 100.0;

/// Noise and discretisation error of a field at `points`.
pub(super) fn variance(bake: &Bake, coarse: &Coarse, field: &Field, points: &[SurfacePoint]) -> Variance {
    let rows = row_noise(bake, field);
    let coarse_light = coarse.light(bake, field);

    // White noise takes the same way as light: two realisations of it tell how much of the noise of patches is left at
    // the points, and how much of it the two levels do not have in common.
    let white: Vec<[f64; 3]> = (0..field.received.len())
        .map(|i| {
            let bits = sampling::hash(&[bake.options.seed, SIGNS, i as u64]);
            let sign = |k: u32| if bits >> k & 1 == 1 { 1.0 } else { -1.0 };
            [luminance(field.received[i]) as f64, sign(0), sign(1)]
        })
        .collect();
    let mut coarse_white = coarse.average(&white);
    coarse_white.iter_mut().zip(&coarse_light).for_each(|(w, e)| w[0] = luminance(vec3(*e)) as f64);
    let lifted = |v: &[[f64; 3]]| v.iter().map(|w| vec3(*w) + Vec3::new(0.0, LIFT, LIFT)).collect::<Vec<Vec3>>();
    let fine = bake.interpolate(points, &lifted(&white), field.sent);
    let coarse =
        reconstruct::interpolate(&coarse.field(bake, &lifted(&coarse_white)), bake.options.reconstruct, points);

    let mut left = Vec::with_capacity(points.len());
    let mut detail = Vec::with_capacity(points.len());
    let share = 1.0 / (2.0_f64.powf(ORDER) - 1.0).powi(2);
    for (p, (fine, coarse)) in points.iter().zip(fine.iter().zip(&coarse)) {
        let row = rows.variance(p, fine.x as f64);
        let kept = *fine - Vec3::splat(LIFT);
        let apart = *coarse - *fine;
        let gain = |v: Vec3| 0.5 * (v.y * v.y + v.z * v.z) as f64;
        left.push(gain(kept) * row);
        detail.push(share * ((apart.x as f64).powi(2) - gain(apart) * row));
    }
    Variance { shadow: vec![0.0; points.len()], rows: left, detail }
}

/// Variance of the irradiance of rows: some are cast again, and meet the radiosity that is known.
fn row_noise(bake: &Bake, field: &Field) -> Local {
    let (f, patches, options) = (&bake.form_factors, bake.patches(), &bake.options);
    let with_rows: Vec<u32> = (0..patches.len() as u32).filter(|&i| f.has_row(i as usize)).collect();
    let picked = chosen(with_rows.len(), SHARE, LEAST, options.seed ^ CHOICE);
    let sent: Vec<f32> = field.sent.iter().map(|b| luminance(*b)).collect();
    let sets = PointSets::new(options.rays as usize, options.seed);
    let again: Vec<(u32, f64)> = picked
        .par_chunks(64)
        .flat_map_iter(|chunk| {
            let (mut emitter, mut rays, mut hits) = (Emitter::default(), RayBatch::default(), Vec::new());
            let mut row = |k: u32| {
                let i = with_rows[k as usize];
                transfer::row_rays(&bake.simplified, &sets, i, options.seed, AGAIN, &mut emitter, &mut rays);
                hits.resize(rays.len(), Hit::NONE);
                bake.patch_tracer().closest_hits(&rays, &mut hits);
                (i, received(bake, &hits, &sent))
            };
            chunk.iter().map(|&k| row(k)).collect::<Vec<_>>()
        })
        .collect();

    let light = |i: u32| luminance(field.received[i as usize]) as f64;
    let area: f64 = again.iter().map(|&(i, _)| patches.area[i as usize] as f64).sum();
    let mean = again.iter().map(|&(i, _)| patches.area[i as usize] as f64 * light(i)).sum::<f64>() / area;
    let mut local = Local::new(bake.simplified.grid, if area > 0.0 { mean } else { 0.0 });
    for (i, second) in again {
        let k = i as usize;
        let place = SurfacePoint { position: patches.centroid[k], normal: patches.normal[k] };
        local.add(&place, patches.area[k] as f64, 0.5 * (second - light(i)).powi(2), light(i));
    }
    local
}

/// Irradiance of a patch by the hits of its rays, counted as form factors count them.
fn received(bake: &Bake, hits: &[Hit], sent: &[f32]) -> f64 {
    let (mut sum, mut count) = (0.0, 0u32);
    for hit in hits {
        if !hit.is_hit() {
            count += !bake.form_factors.is_closed() as u32;
        } else if let Some(j) = bake.patch_of(hit) {
            sum += sent[j as usize] as f64;
            count += 1;
        }
    }
    sum / count.max(1) as f64
}

pub(super) fn vec3(v: [f64; 3]) -> Vec3 {
    Vec3::from_array(v.map(|x| x as f32))
}
