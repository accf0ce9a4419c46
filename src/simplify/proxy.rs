//! Patches of a hand-made simplified mesh.

use rayon::prelude::*;

use super::{
    Grid, Simplified,
    feet::feet,
    triangles::{Mesh, points_of, simplified, visible_area},
};
use crate::{Error, Result, Scene, scene::Proxy, trace::RayTracer};

/// Points of a triangle that ask for the surfaces it stands for, on each axis.
const SAMPLES: u32 = 3;

/// Cuts the triangles of the scene's proxy to about `target` patches, by default to the area of a voxel face. Each
/// triangle fronts where the surfaces fronts that it stands for do, whatever its winding, and has two sides if they have.
///
/// # Errors
/// [`Error::Option`] without a proxy; [`Error::Input`] for a triangle that is near no surface of the scene.
pub fn proxy(scene: &Scene, grid: Grid, target: Option<u32>, tracer: &dyn RayTracer) -> Result<Simplified> {
    let Some(proxy) = &scene.proxy else {
        return Err(Error::Option(
            "patches of a proxy need one: give --proxy FILE, or proxy = \"FILE\" in the scene file's [bake] table"
                .into(),
        ));
    };
    let sides: Result<Vec<Sides>> =
        (0..proxy.triangles.len()).into_par_iter().map(|t| sides(scene, proxy, t, tracer)).collect();
    let mut mesh = Mesh { positions: proxy.positions.clone(), ..Mesh::default() };
    for (&[a, b, c], sides) in proxy.triangles.iter().zip(sides?) {
        mesh.triangles.push(if sides.turned { [a, c, b] } else { [a, b, c] });
        mesh.two_sided.push(sides.two);
    }
    let size = target.map_or(grid.voxel_size, |n| (visible_area(scene) / n as f64).sqrt()) as f32;
    Ok(simplified(scene, grid, mesh, size, tracer))
}

/// Which sides of a triangle of the proxy stand for real ones.
struct Sides {
    turned: bool,
    two: bool,
}

/// By the votes of some points of the triangle.
fn sides(scene: &Scene, proxy: &Proxy, t: usize, tracer: &dyn RayTracer) -> Result<Sides> {
    let corners = proxy.triangles[t].map(|v| proxy.positions[v as usize]);
    let points: Vec<_> = points_of(&corners, false, SAMPLES).collect();
    let (mut front, mut back, mut two) = (0, 0, 0);
    for (point, foot) in points.iter().zip(feet(scene, tracer, &points, true)) {
        let Some(foot) = foot else { continue };
        let real = foot.hit.triangle();
        if scene.triangles[real].two_sided {
            two += 1;
        } else if scene.normal(real).dot(point.normal) >= 0.0 {
            front += 1;
        } else {
            back += 1;
        }
    }
    if front + back + two == 0 {
        return Err(proxy.wrong(
            scene,
            t,
            "is near no surface of the scene: move it to the surfaces that it stands for, or remove it",
        ));
    }
    Ok(Sides { turned: back > front, two: two > front + back })
}
