//! What holds in every scene: power is kept, form factors are reciprocal, their rows sum to one.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::{Row, World, rows};
use crate::{
    BakeOptions, Result,
    bake::Bake,
    options::{Backend, Resolution},
    progress::Silent,
    scene::WorldLight,
};

/// Largest imbalance of power at the default number of rays, and the exitance times area of the lamp.
const BALANCE: f64 = 0.002;
const LAMP: f64 = 10.0 * 0.09 * PI;

/// A room with a block in it, and a lamp under its ceiling; without a ceiling and with a sun, if `open`.
pub fn furnished(open: bool) -> World {
    let mut world = World::new();
    let (wall, lamp) = (world.coloured(Vec3::new(0.8, 0.5, 0.2), 0.0), world.grey(0.0, 10.0));
    let size = DVec3::new(1.0, 1.2, 0.9);
    if open {
        let (x, y, z) = (DVec3::X * size, DVec3::Y * size, DVec3::Z * size);
        world.quad("room", DVec3::ZERO, x, y, wall);
        for (corner, along) in [(DVec3::ZERO, x), (x + y, -x), (x, y), (y, -y)] {
            world.quad("room", corner, z, along, wall);
        }
        world
            .builder
            .add_light(WorldLight::Sun { direction: DVec3::new(0.3, 0.4, -1.0), irradiance: Vec3::splat(5.0) });
    } else {
        world.room(DVec3::ZERO, size, wall);
        world.quad("lamp", DVec3::new(0.4, 0.4, 0.85), DVec3::Y * 0.3, DVec3::X * 0.3, lamp);
    }
    world.block(DVec3::new(0.2, 0.3, 0.0), DVec3::new(0.5, 0.6, 0.4), wall);
    world
}

pub(super) fn invariants(backend: Backend) -> Result<Vec<Row>> {
    let options = BakeOptions { resolution: Resolution::Grid(24), backend, ..BakeOptions::default() };
    let scene = furnished(false).build()?.0;
    let closed = crate::bake(&scene, &options, &Silent)?;
    let open = crate::bake(&furnished(true).build()?.0, &options, &Silent)?;
    let energy = &closed.report.energy;
    let balance = |bake: &Bake| {
        let e = &bake.report.energy;
        let kept: Vec<f64> = (0..3).map(|c| e.absorbed[c] + e.escaped[c]).collect();
        (kept, e.direct.to_vec())
    };
    let (kept, sent) = balance(&open);
    Ok(vec![
        Row::worst("power of a lamp that arrives", &energy.direct, &[LAMP; 3], BALANCE),
        // What meets the back of the one-sided lamp counts as escaped.
        Row::worst("power of a lamp, absorbed and escaped", &balance(&closed).0, &[LAMP; 3], BALANCE),
        Row::worst("power of a sun, absorbed and escaped", &kept, &sent, BALANCE),
        reciprocity(&closed, &options, &|i| rows::mesh_of(&scene, &closed, i) == "block"),
        row_sums("row sums, closed room", &closed),
        row_sums("row sums with what escapes, open room", &open),
    ])
}

/// A_i F_ij = A_j F_ji between the groups of patches of one direction and one object: the worst pair.
fn reciprocity(bake: &Bake, options: &BakeOptions, block: &dyn Fn(usize) -> bool) -> Row {
    let patches = bake.patches();
    let group = |i: usize| {
        let n = patches.normal[i];
        let axis = n.abs().max_position();
        2 * axis + (n[axis] > 0.0) as usize + if block(i) { 6 } else { 0 }
    };
    let groups: Vec<usize> = (0..patches.len()).map(group).collect();
    let area = |g: usize| -> f64 {
        let own = (0..groups.len()).filter(|&i| groups[i] == g && bake.form_factors.has_row(i));
        own.map(|i| rows::visible_area(patches, &bake.form_factors, i)).sum()
    };
    let sent = |from: usize, to: usize| {
        let in_from = |i: usize| groups[i] == from && bake.form_factors.has_row(i);
        rows::between(patches, &bake.form_factors, options, in_from, |j| groups[j] == to)
    };
    let mut worst: Option<Row> = None;
    for (a, b) in (0..12).flat_map(|a| (a + 1..12).map(move |b| (a, b))) {
        let ((there, sigma), (back, sigma_back)) = (sent(a, b), sent(b, a));
        let (area, area_back) = (area(a), area(b));
        // Walls that do not see each other have nothing to say.
        if there > 0.0 && back > 0.0 {
            let sigma = (area * sigma).hypot(area_back * sigma_back);
            let row = Row::sigmas("reciprocity, walls of a room and a block", area * there, area_back * back, sigma);
            worst = Some(worst.map_or(row.clone(), |w| w.or_worse(row)));
        }
    }
    worst.unwrap_or_else(|| Row::error("reciprocity: no pair of walls", f64::NAN, 1.0, 0.0))
}

/// What a row sends to patches and out of the scene is one; sums of at most 65536 terms in double precision.
fn row_sums(case: &str, bake: &Bake) -> Row {
    let f = &bake.form_factors;
    let rows = (0..f.len()).filter(|&i| f.has_row(i));
    let sums: Vec<f64> = rows.map(|i| f.row(i).map(|(_, f)| f).sum::<f64>() + f.escape(i)).collect();
    Row::worst(case, &sums, &vec![1.0; sums.len()], 65536.0 * f64::EPSILON)
}
