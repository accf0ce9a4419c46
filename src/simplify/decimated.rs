//! Patches by mesh simplification, which the paper's section 3 compares its voxels with: edge collapse by quadric error
//! (Garland & Heckbert 1997) and vertex clustering (Rossignac & Borrel 1993), both as meshoptimizer does them.

use std::collections::HashMap;

use glam::Vec3;
use meshoptimizer_rs::{Limits, Positions, SimplifyOptions, SimplifySettings, Workspace};

use super::{
    Grid, Simplified,
    triangles::{Mesh, simplified, subdivide, visible_area},
};
use crate::{Error, Result, Scene, trace::RayTracer};

/// How the mesh is simplified.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Edges collapse, those first that move the surface least.
    Decimate,
    /// Vertices in the same cell of a grid become one.
    Cluster,
}

/// Edges of the mesh that is simplified, in units of the edge of a square that has the mean area of the patches.
const FINE: f32 = 0.75;

/// Simplifies the scene's mesh to about `target` patches, by default so many that their mean area is that of a voxel
/// face. Walls of two triangles cannot be simplified into patches, so the mesh is subdivided first; what the
/// simplification leaves larger than a patch is cut again.
///
/// # Errors
/// [`Error::Scene`] for a mesh that cannot be simplified.
pub fn decimated(
    scene: &Scene,
    grid: Grid,
    method: Method,
    target: Option<u32>,
    tracer: &dyn RayTracer,
) -> Result<Simplified> {
    let area = visible_area(scene);
    let size = target.map_or(grid.voxel_size, |n| (area / n as f64).sqrt()) as f32;
    let mut whole = Mesh::default();
    // Each on its own: a two-sided sheet that melts into a solid would have neither's sides.
    for two_sided in [false, true] {
        let mut part = welded(scene, two_sided);
        subdivide(&mut part, FINE * size);
        let area: f64 = (0..scene.triangles.len())
            .filter(|&t| scene.triangles[t].two_sided == two_sided)
            .map(|t| scene.area(t))
            .sum();
        let target = ((area / (size as f64 * size as f64)).round() as usize).max(4);
        let triangles = simplify(&part, method, target)?;
        let first = whole.positions.len() as u32;
        whole.positions.append(&mut part.positions);
        whole.two_sided.resize(whole.two_sided.len() + triangles.len(), two_sided);
        whole.triangles.extend(triangles.into_iter().map(|t| t.map(|v| first + v)));
    }
    if whole.triangles.is_empty() {
        return Err(Error::Scene(format!(
            "scene \"{}\": simplification leaves no triangle; use a finer --grid, more --target-patches, or --patches \
             surfels",
            scene.name
        )));
    }
    Ok(simplified(scene, grid, whole, size, tracer))
}

/// The scene's one- or two-sided triangles, with equal positions made one.
fn welded(scene: &Scene, two_sided: bool) -> Mesh {
    let mut mesh = Mesh::default();
    let mut numbers: HashMap<[u32; 3], u32> = HashMap::new();
    for t in (0..scene.triangles.len()).filter(|&t| scene.triangles[t].two_sided == two_sided) {
        mesh.triangles.push(scene.corners_of(t).map(|p| {
            // Adding zero makes -0 and 0 one place.
            *numbers.entry((p + Vec3::ZERO).to_array().map(f32::to_bits)).or_insert_with(|| {
                mesh.positions.push(p);
                mesh.positions.len() as u32 - 1
            })
        }));
        mesh.two_sided.push(two_sided);
    }
    mesh
}

fn simplify(mesh: &Mesh, method: Method, target: usize) -> Result<Vec<[u32; 3]>> {
    if mesh.triangles.len() <= target {
        return Ok(mesh.triangles.clone());
    }
    let indices = mesh.triangles.as_flattened();
    let positions: Vec<[f32; 3]> = mesh.positions.iter().map(Vec3::to_array).collect();
    let positions = Positions::from_packed(&positions);
    // The size of the grid is what bounds memory, see `check_size`.
    let mut workspace = Workspace::new(Limits { max_bytes: usize::MAX, max_work: u64::MAX });
    // The count is what is asked for, whatever the error.
    let result = match method {
        Method::Decimate => {
            let options = SimplifyOptions::REGULARIZE;
            let settings = SimplifySettings { target_index_count: 3 * target, target_error: 1.0, options };
            meshoptimizer_rs::simplify(indices, positions, settings, &mut workspace)
        }
        Method::Cluster => meshoptimizer_rs::simplify_sloppy(indices, positions, None, 3 * target, 1.0, &mut workspace),
    };
    let simple = result
        .map_err(|e| Error::Scene(format!("the scene's mesh cannot be simplified: {e}; use --patches surfels")))?;
    Ok(simple.indices.as_chunks::<3>().0.to_vec())
}
