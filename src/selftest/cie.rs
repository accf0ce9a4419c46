//! Test cases of CIE 171:2006, as whole bakes.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::{
    Row, World,
    closed_forms::{
        CIE_5_8_DIRECT, CIE_5_8_MEANS, CIE_5_8_PLACES, CIE_5_8_POINTS, closed_mean, cycles, point_to_polygon,
    },
    options, rows,
    world::{Placement, rotation},
};
use crate::{
    Result, Scene,
    options::{Backend, Reconstruct},
    progress::Silent,
    scene::{SurfacePoint, WorldLight},
};

/// Rays of a point where some tens of points are all that is asked for.
const GATHER_RAYS: u32 = 65536;

/// A place and its normal, in the coordinates that the scene is built in.
type Place = ([f64; 3], [f64; 3]);

/// Radiance of the source of test 5.3, cd/m2: 1 m2 and 1000 pi lm.
const SOURCE: f64 = 1000.0;

/// Test 5.3: a diffuse source in the ceiling of a black room.
pub fn area_source() -> World {
    let mut world = World::new();
    let black = world.grey(0.0, 0.0);
    world.room(DVec3::ZERO, DVec3::new(4.0, 4.0, 3.0), black);
    world.builder.add_light(WorldLight::Rectangle {
        corner: DVec3::new(1.5, 1.5, 3.0),
        edge_u: DVec3::Y,
        edge_v: DVec3::X,
        radiance: Vec3::splat(SOURCE as f32),
    });
    world
}

/// The points of [`CIE_5_3`](super::closed_forms::CIE_5_3).
pub fn area_source_places() -> Vec<Place> {
    let wall = (0..6).map(|k| ([2.0, 0.0, 2.75 - 0.5 * k as f64], [0.0, 1.0, 0.0]));
    wall.chain((0..4).map(|k| ([2.0, 0.25 + 0.5 * k as f64, 0.0], [0.0, 0.0, 1.0]))).collect()
}

/// Illuminances there by Lambert's formula.
pub fn area_source_answers() -> Vec<f64> {
    answers(&area_source_places(), &horizontal_square(1.0, 3.0), SOURCE * PI)
}

/// Irradiances of places from a polygon of some exitance.
fn answers(places: &[Place], polygon: &[DVec3], exitance: f64) -> Vec<f64> {
    places.iter().map(|&(p, n)| exitance * point_to_polygon(p.into(), n.into(), polygon)).collect()
}

/// Around (2, 2).
fn horizontal_square(edge: f64, z: f64) -> [DVec3; 4] {
    [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]].map(|[x, y]| DVec3::new(2.0 + edge * x, 2.0 + edge * y, z))
}

/// Test 5.6: a wall and a ceiling, black, over a square of reflectance 0.3 and `edge` m. The irradiance E_hz of the
/// square is such that the wall's and the ceiling's are the printed 100 E / (E_hz rho).
pub fn one_bounce(edge: f64) -> World {
    let mut world = World::new();
    let (black, grey) = (world.grey(0.0, 0.0), world.grey(0.3, 0.0));
    let low = 2.0 - 0.5 * edge;
    world.quad("S2", DVec3::new(low, low, 0.0), DVec3::X * edge, DVec3::Y * edge, grey);
    world.quad("wall", DVec3::ZERO, DVec3::Z * 3.0, DVec3::X * 4.0, black);
    world.quad("ceiling", DVec3::Z * 3.0, DVec3::Y * 4.0, DVec3::X * 4.0, black);
    // Flat enough to come in under the ceiling, along the wall: it lights nothing but S2.
    let direction = DVec3::new(-10.0, 0.0, -1.0);
    let irradiance = Vec3::splat((direction.length() * 100.0 / 0.3) as f32);
    world.builder.add_light(WorldLight::Sun { direction, irradiance });
    world
}

/// The points of [`CIE_5_6_SMALL`](super::closed_forms::CIE_5_6_SMALL), or of the table for 4 m, which leaves out the
/// lowest.
pub fn one_bounce_places(edge: f64) -> Vec<Place> {
    let lowest = if edge > 1.0 { 1 } else { 0 };
    let wall = (lowest..6).map(|k| ([2.0, 0.0, 0.25 + 0.5 * k as f64], [0.0, 1.0, 0.0]));
    wall.chain((0..4).map(|k| ([2.0, 0.25 + 0.5 * k as f64, 3.0], [0.0, 0.0, -1.0]))).collect()
}

/// The values there by Lambert's formula.
pub fn one_bounce_answers(edge: f64) -> Vec<f64> {
    answers(&one_bounce_places(edge), &horizontal_square(edge, 0.0), 100.0)
}

/// Flux of the source of tests 5.4 and 5.8, lm.
pub const FLUX: f64 = 10_000.0;

/// Test 5.4: a black room with a point source near its ceiling.
pub fn closed_room() -> World {
    let mut world = World::new();
    let black = world.grey(0.0, 0.0);
    world.room(DVec3::ZERO, DVec3::new(4.0, 4.0, 3.0), black);
    world.point_light(DVec3::new(2.0, 2.0, 2.9), FLUX);
    world
}

/// Test 5.8: a cube of 4 m with a point source in its middle, as built or turned; an albedo a channel.
pub fn cube(albedo: Vec3, turned: bool) -> World {
    let mut world = World::new();
    let grey = world.coloured(albedo, 0.0);
    world.room(DVec3::splat(-2.0), DVec3::splat(2.0), grey);
    world.point_light(DVec3::ZERO, FLUX);
    if turned {
        world.transform(rotation());
    }
    world
}

/// The places of [`CIE_5_8_PLACES`] on all six faces.
pub fn cube_places() -> Vec<Place> {
    let faces = (0..3).flat_map(|axis| [(axis, -1.0), (axis, 1.0)]);
    faces
        .flat_map(|(axis, side)| {
            CIE_5_8_PLACES.map(|[a, b]| {
                let mut p = DVec3::ZERO;
                (p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3]) = (2.0 * side, a, b);
                (p.to_array(), (DVec3::AXES[axis] * -side).to_array())
            })
        })
        .collect()
}

fn points(scene: &Scene, placement: &Placement, places: &[Place]) -> Vec<SurfacePoint> {
    places.iter().map(|&(p, n)| placement.point(scene, p, n)).collect()
}

fn channel(values: &[Vec3], c: usize) -> Vec<f64> {
    values.iter().map(|v| v[c] as f64).collect()
}

pub(super) fn test_5_3(backend: Backend) -> Result<Vec<Row>> {
    let (scene, placement) = area_source().build()?;
    let bake = crate::bake(&scene, &options(16, 64, backend), &Silent)?;
    let light = bake.irradiance(&points(&scene, &placement, &area_source_places()), &Silent);
    let got = channel(&light.direct, 0);
    // Half a unit of the table's last digit.
    let row = Row::worst("CIE 5.3, area source, 10 points", &got, &area_source_answers(), 0.005 / 32.68);
    Ok(vec![row.published(cycles::CIE_5_3)])
}

pub(super) fn test_5_4(backend: Backend) -> Result<Vec<Row>> {
    let bake = crate::bake(&closed_room().build()?.0, &options(32, 64, backend), &Silent)?;
    let row = Row::error("CIE 5.4, flux of a point source", bake.report.energy.direct[0], FLUX, cycles::CIE_5_4);
    Ok(vec![row.published(cycles::CIE_5_4)])
}

pub(super) fn test_5_6(backend: Backend) -> Result<Vec<Row>> {
    let run = |edge: f64, gathers: bool| {
        let (scene, placement) = one_bounce(edge).build()?;
        let mut bake = crate::bake(&scene, &options(32, 256, backend), &Silent)?;
        if gathers {
            bake.set_reconstruct(Reconstruct::Gather, GATHER_RAYS);
        }
        let light = bake.irradiance(&points(&scene, &placement, &one_bounce_places(edge)), &Silent);
        let case = format!("CIE 5.6, one bounce off {edge} m");
        let row = Row::worst(case, &channel(&light.indirect, 0), &one_bounce_answers(edge), cycles::CIE_5_6);
        Ok(row.published(cycles::CIE_5_6))
    };
    // The large square is no lamp: few rays would find its light only roughly.
    Ok(vec![run(0.5, false)?, run(4.0, true)?])
}

pub(super) fn test_5_8(backend: Backend) -> Result<Vec<Row>> {
    let mut table = Vec::new();
    for turned in [false, true] {
        let how = if turned { "turned" } else { "as built" };
        table.push(means(&format!("CIE 5.8, cube {how}, means"), turned, backend)?.published(cycles::CIE_5_8));
        table.extend(pointwise(&format!("CIE 5.8, cube {how}"), turned, backend)?);
    }
    Ok(table)
}

/// Area means at all eleven albedos, three in a bake.
fn means(case: &str, turned: bool, backend: Backend) -> Result<Row> {
    let (mut got, mut expected) = (Vec::new(), Vec::new());
    for three in CIE_5_8_MEANS.chunks(3) {
        let albedo = |c: usize| three[c.min(three.len() - 1)].0;
        let scene = cube(Vec3::from_array([0, 1, 2].map(|c| albedo(c) as f32)), turned).build()?.0;
        let bake = crate::bake(&scene, &options(10, 1024, backend), &Silent)?;
        let mean = rows::patch_mean(&bake, &bake.light.indirect);
        got.extend((0..three.len()).map(|c| mean[c]));
        expected.extend((0..three.len()).map(|c| closed_mean(FLUX, 96.0, albedo(c))));
    }
    Ok(Row::worst(case, &got, &expected, cycles::CIE_5_8))
}

/// Five points on each of the six faces, at both albedos of the table in one bake.
fn pointwise(case: &str, turned: bool, backend: Backend) -> Result<Vec<Row>> {
    let [(low, _), (high, _)] = CIE_5_8_POINTS;
    let (scene, placement) = cube(Vec3::new(low as f32, high as f32, 0.0), turned).build()?;
    let mut bake = crate::bake(&scene, &options(48, 256, backend), &Silent)?;
    bake.set_reconstruct(Reconstruct::Gather, GATHER_RAYS);
    let light = bake.irradiance(&points(&scene, &placement, &cube_places()), &Silent);
    let (mut got, mut expected) = (Vec::new(), Vec::new());
    for (c, (_, table)) in CIE_5_8_POINTS.iter().enumerate() {
        got.extend(channel(&light.indirect, c));
        expected.extend(table.repeat(6));
    }
    let indirect = Row::worst(format!("{case}, 60 points"), &got, &expected, cycles::CIE_5_8);
    // Four or five digits: half a unit of 49.40, and the rounding of positions.
    let direct = Row::worst(
        format!("{case}, direct light"),
        &channel(&light.direct, 0),
        &CIE_5_8_DIRECT.repeat(6),
        0.005 / 49.40 + 1e-5,
    );
    Ok(vec![indirect.published(cycles::CIE_5_8), direct])
}
