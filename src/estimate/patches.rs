//! Error of light that patches carry.

use glam::Vec3;
use rayon::prelude::*;

use super::{
    LookedAt, Variance,
    coarse::{Coarse, CoarseLight},
    gathers,
    local::Local,
    replicates::Replicates,
};
use crate::{bake::Bake, colour::luminance, options::Reconstruct, reconstruct, sampling, scene::SurfacePoint};

/// A light that patches send each other by form factors.
pub struct Field<'a> {
    /// Irradiance of the patches, W/m2.
    pub received: &'a [Vec3],
    /// Radiosity of the patches that it came from, W/m2.
    pub sent: &'a [Vec3],
    /// Whether what is received is sent on.
    pub reflects: bool,
}

/// Purpose word of random bits.
const SIGNS: u64 = 0x7369_676e;
/// Discretisation errors fall about as this power of the voxel size: between 0.9 and 1.4 from grid 16 to 64 on the Cornell
/// box, a room with curved surfaces and two rooms with a door.
const ORDER: f64 = 1.25;
/// Added to white noise, because light is never negative.
const LIFT: f32 = 100.0;

/// Noise and discretisation error of a field at the points that are `looked_at`.
pub(super) fn variance(
    bake: &Bake,
    coarse: &Coarse,
    field: &Field,
    looked_at: &LookedAt,
    replicates: &Replicates,
) -> Variance {
    let (light, rows) = rayon::join(|| coarse.light(bake, field), || row_noise(bake, field, replicates));
    let (fitted, mut variance) = interpolated(bake, coarse, field, &light, looked_at, &rows);
    gathers::correct(bake, field, &light.sent, looked_at, &fitted, &mut variance);
    variance
}

/// Of light that is interpolated between patches, with its luminance.
///
/// White noise takes the same way as light: two realisations of it tell how much of the noise of patches is left at the
/// points, and how much of it the two levels do not have in common.
fn interpolated(
    bake: &Bake,
    coarse: &Coarse,
    field: &Field,
    light: &CoarseLight,
    looked_at: &LookedAt,
    rows: &Local,
) -> (Vec<f64>, Variance) {
    let points = &looked_at.points;
    let white: Vec<[f64; 3]> = (0..field.received.len())
        .into_par_iter()
        .map(|i| {
            let bits = sampling::hash(&[bake.options.seed, SIGNS, i as u64]);
            let sign = |k: u32| if bits >> k & 1 == 1 { 1.0 } else { -1.0 };
            [luminance(field.received[i]), sign(0), sign(1)]
        })
        .collect();
    let mut coarse_white = coarse.average(&white);
    coarse_white.iter_mut().zip(&light.received).for_each(|(w, e)| w[0] = luminance(vec3(*e)));
    let lifted = |v: &[[f64; 3]]| v.iter().map(|w| vec3(*w) + Vec3::new(0.0, LIFT, LIFT)).collect::<Vec<Vec3>>();
    let (white, coarse_white) = (lifted(&white), lifted(&coarse_white));
    let method = if bake.options.reconstruct.gathers() { Reconstruct::Smooth } else { bake.options.reconstruct };
    let of_bake = reconstruct::Field { stencils: Some(&looked_at.stencils), ..bake.field(&white, field.sent) };
    let (fine, coarse) = rayon::join(
        || reconstruct::interpolate(&of_bake, method, points),
        || reconstruct::interpolate(&coarse.field(bake, &coarse_white), method, points),
    );

    let gain = |v: Vec3| 0.5 * (v.y * v.y + v.z * v.z) as f64;
    let of_point = |(p, (fine, coarse)): (&SurfacePoint, (&Vec3, &Vec3))| {
        let row = rows.variance(p, fine.x as f64);
        let kept = *fine - Vec3::splat(LIFT);
        let apart = *coarse - *fine;
        (gain(kept) * row, detail_of((apart.x as f64).powi(2) - gain(apart) * row))
    };
    let (rows, detail) = points.par_iter().zip(fine.par_iter().zip(&coarse)).map(of_point).unzip();
    let fitted = fine.iter().map(|e| e.x as f64).collect();
    (fitted, Variance { shadow: vec![0.0; points.len()], rows, detail })
}

/// The square of the discretisation error of a bake by the square of what larger patches change.
pub(super) fn detail_of(square: f64) -> f64 {
    square / (2.0_f64.powf(ORDER) - 1.0).powi(2)
}

/// Variance of the irradiance of rows: their replicates meet the radiosity that is known.
fn row_noise(bake: &Bake, field: &Field, replicates: &Replicates) -> Local {
    let (patches, picked) = (bake.patches(), &replicates.patches);
    let sent: Vec<f32> = field.sent.iter().map(|b| luminance(*b) as f32).collect();
    let received = replicates.receive(&sent, bake.form_factors.is_closed());

    let light = |i: u32| luminance(field.received[i as usize]);
    let area: f64 = picked.iter().map(|&i| patches.area[i as usize] as f64).sum();
    let mean = picked.iter().map(|&i| patches.area[i as usize] as f64 * light(i)).sum::<f64>() / area;
    let mut local = Local::new(bake.simplified.grid, if area > 0.0 { mean } else { 0.0 });
    for (&i, second) in picked.iter().zip(received) {
        let k = i as usize;
        let place = SurfacePoint { position: patches.centroid[k], normal: patches.normal[k] };
        local.add(&place, patches.area[k] as f64, 0.5 * (second - light(i)).powi(2), light(i));
    }
    local
}

pub(super) fn vec3(v: [f64; 3]) -> Vec3 {
    Vec3::from_array(v.map(|x| x as f32))
}
