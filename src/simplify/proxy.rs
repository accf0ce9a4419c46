//! Patches of a hand-made simplified mesh.

use glam::Vec3;
use rayon::prelude::*;

use super::{
    Grid, Simplified,
    feet::feet,
    triangles::{Mesh, points_of, simplified, visible_area},
};
use crate::{Error, Result, Scene, scene::SurfacePoint, trace::RayTracer};

/// Points of a triangle that tell which sides of it are real, on each axis.
const VOTERS: u32 = 3;

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
    let mut mesh = Mesh { positions: proxy.positions.clone(), ..Mesh::default() };
    for (t, votes) in votes(scene, &proxy.positions, &proxy.triangles, tracer).into_iter().enumerate() {
        let [a, b, c] = proxy.triangles[t];
        if votes.front + votes.back + votes.two == 0 {
            return Err(proxy.wrong(
                scene,
                t,
                "is near no surface of the scene: move it to the surfaces that it stands for, or remove it",
            ));
        }
        mesh.triangles.push(if votes.back > votes.front { [a, c, b] } else { [a, b, c] });
        mesh.two_sided.push(votes.two > votes.front + votes.back);
    }
    let size = target.map_or(grid.voxel_size, |n| (visible_area(scene) / n as f64).sqrt()) as f32;
    Ok(simplified(scene, grid, mesh, size, tracer))
}

/// How many points of a triangle stand for surfaces of which side.
#[derive(Clone, Copy, Debug, Default)]
struct Votes {
    /// One-sided surfaces that face as the triangle does.
    front: u32,
    /// One-sided surfaces that face the other way.
    back: u32,
    /// Surfaces of two sides.
    two: u32,
}

/// Asks some points of every triangle for the nearest real surface.
fn votes(scene: &Scene, positions: &[Vec3], triangles: &[[u32; 3]], tracer: &dyn RayTracer) -> Vec<Votes> {
    triangles
        .par_chunks(256)
        .flat_map_iter(|chunk| {
            let corners = chunk.iter().map(|t| t.map(|v| positions[v as usize]));
            let points: Vec<SurfacePoint> = corners.flat_map(|c| points_of(&c, false, VOTERS)).collect();
            let mut all = vec![Votes::default(); chunk.len()];
            for (i, foot) in feet(scene, tracer, &points, true).into_iter().enumerate() {
                let Some(foot) = foot else { continue };
                let votes = &mut all[i / (VOTERS * VOTERS) as usize];
                let t = foot.hit.triangle();
                let of = if scene.triangles[t].two_sided {
                    &mut votes.two
                } else if scene.normal(t).dot(points[i].normal) >= 0.0 {
                    &mut votes.front
                } else {
                    &mut votes.back
                };
                *of += 1;
            }
            all
        })
        .collect()
}
