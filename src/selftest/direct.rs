//! The light of polygons at points, against Lambert's formula.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::{Row, World, closed_forms::point_to_polygon};
use crate::{
    Result,
    light::{self, LightSet},
    options::Backend,
    scene::{SurfacePoint, WorldLight},
    trace,
};

/// Rounding of positions and of sums to single precision; the formula's values are double.
const ROUNDING: f64 = 1e-5;
/// Shadow rays of the half-hidden square.
const SHADOW_RAYS: u32 = 1024;

/// A square lamp of edge 1 at height 1, radiating down.
fn lamp() -> WorldLight {
    WorldLight::Rectangle {
        corner: DVec3::new(-0.5, -0.5, 1.0),
        edge_u: DVec3::Y,
        edge_v: DVec3::X,
        radiance: Vec3::splat((1.0 / PI) as f32),
    }
}

fn rectangle(x: [f64; 2], y: [f64; 2]) -> [DVec3; 4] {
    [[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]].map(|[x, y]| DVec3::new(x, y, 1.0))
}

pub(super) fn polygons(backend: Backend) -> Result<Vec<Row>> {
    let square = rectangle([-0.5, 0.5], [-0.5, 0.5]);
    let see = |case: &str, p: DVec3, n: DVec3, seen: &[DVec3]| {
        let got = lit(World::new(), p, n, 64, backend)?;
        Ok(Row::error(case, got, point_to_polygon(p, n, seen), ROUNDING))
    };
    let tilted = DVec3::new(0.6, 0.0, 0.8);
    let mut table = vec![
        see("unit square from under its centre", DVec3::ZERO, DVec3::Z, &square)?,
        see("unit square from under its corner", DVec3::new(0.5, 0.5, 0.0), DVec3::Z, &square)?,
        see("unit square from aside, tilted", DVec3::new(-0.9, 0.3, 0.2), tilted, &square)?,
        // A receiver that stands upright under the middle sees one half.
        see("unit square cut by the horizon", DVec3::ZERO, DVec3::X, &rectangle([0.0, 0.5], [-0.5, 0.5]))?,
    ];

    // A screen at half the height hides all of the square beyond x = 0.1.
    let mut world = World::new();
    let black = world.grey(0.0, 0.0);
    world.quad("screen", DVec3::new(0.05, -1.0, 0.5), DVec3::Y * 2.0, DVec3::X, black);
    let got = lit(world, DVec3::ZERO, DVec3::Z, SHADOW_RAYS, backend)?;
    let expected = point_to_polygon(DVec3::ZERO, DVec3::Z, &rectangle([-0.5, 0.1], [-0.5, 0.5]));
    let whole = point_to_polygon(DVec3::ZERO, DVec3::Z, &square);
    let share = expected / whole;
    let sigma = whole * (share * (1.0 - share) / SHADOW_RAYS as f64).sqrt();
    table.push(Row::sigmas("unit square, part of it behind a screen", got, expected, sigma));
    Ok(table)
}

/// Irradiance of a point by the lamp, pi times the radiance being 1.
fn lit(mut world: World, p: DVec3, n: DVec3, samples: u32, backend: Backend) -> Result<f64> {
    // A scene has surfaces: a floor well under the points.
    let black = world.grey(0.0, 0.0);
    world.quad("floor", DVec3::new(-1.0, -1.0, -1.0), DVec3::X * 2.0, DVec3::Y * 2.0, black);
    world.builder.add_light(lamp());
    let (scene, placement) = world.build()?;
    let point: SurfacePoint = placement.point(&scene, p.to_array(), n.to_array());
    let tracer = trace::build(backend, &scene.geometry())?;
    Ok(light::irradiance(&LightSet::new(&scene), &*tracer, &[point], 1, samples, 0).irradiance[0].x as f64)
}
