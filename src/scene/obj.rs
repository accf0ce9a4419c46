//! Wavefront OBJ files.
//!
//! `v x y z r g b` gives vertex colours, taken as linear. `vt` starts at the bottom row. Polygons of any shape are cut
//! into triangles by [`super::polygon`]. Groups and objects name the meshes. A positive index must name a vertex
//! that stands above the face. Lines, points, curves and smoothing groups are ignored; surfaces without `vn` are flat.

use std::{collections::HashMap, path::Path};

use glam::{DVec3, Vec2, Vec3};

use super::{
    Material,
    builder::{Builder, list},
    mtl::{self, DEFAULT_ALBEDO, TextureCache},
    obj_scan::{self, Run},
    path, polygon,
    raw::{RawMaterial, RawMesh},
};
use crate::{Error, Result};

/// Reads an OBJ file and its material libraries into `builder`.
///
/// # Errors
/// [`Error::Io`], or [`Error::Input`] with the line of a number that is none or an index that does not exist. What is
/// merely useless (faces with two corners, missing libraries and textures) becomes warnings.
pub(crate) fn read(file: &Path, builder: &mut Builder) -> Result<()> {
    let bytes = std::fs::read(file).map_err(|e| Error::io(file, e))?;
    let scan = obj_scan::scan(&String::from_utf8_lossy(&bytes))
        .map_err(|(line, message)| Error::input(file, format!("line {line}"), message))?;
    drop(bytes);
    let options = tobj::LoadOptions { single_index: true, ..Default::default() };
    let no_materials = |_: &Path| Ok((Vec::new(), Default::default()));
    let (models, _) = tobj::load_obj_buf(&mut scan.text.as_bytes(), &options, no_materials)
        .map_err(|e| Error::input(file, "", e.to_string()))?;

    let mut materials = libraries(file, &scan.libraries, builder)?;
    let undefined = undefined_materials(&scan.runs, builder, &mut materials);
    if !undefined.is_empty() {
        builder.warn(format!(
            "{}: materials that no library defines are grey, albedo {}: {}",
            file.display(),
            DEFAULT_ALBEDO.x,
            list(&undefined, 8)
        ));
    }
    if scan.mixed_colours {
        builder
            .warn(format!("{}: only some vertices have a colour; vertices without one count as white", file.display()));
    }
    if !scan.short_faces.is_empty() {
        let lines: Vec<String> = scan.short_faces.iter().map(|l| format!("line {l}")).collect();
        builder.warn(format!(
            "{}: {} faces with fewer than 3 corners were dropped: {}",
            file.display(),
            lines.len(),
            list(&lines, 3)
        ));
        builder.count_short_faces(lines.len());
    }
    // The scan writes an `o` before every run and no run is empty, so that models and runs are the same list.
    if !scan.runs.is_empty() && models.len() != scan.runs.len() {
        return Err(Error::input(file, "", format!("{} groups of faces became {}", scan.runs.len(), models.len())));
    }
    let mut repeated = Vec::new();
    for (model, run) in models.into_iter().zip(&scan.runs) {
        let material = materials[run.material.as_deref().unwrap_or("")];
        builder.add_mesh(to_mesh(model.mesh, run, material, &mut repeated));
    }
    if !repeated.is_empty() {
        builder.warn(format!(
            "{}: {} polygons visit a corner more than once, it counts once: {}",
            file.display(),
            repeated.len(),
            list(&repeated, 3)
        ));
    }
    Ok(())
}

/// Reads all libraries; returns the materials by name. What cannot be read is warned of once.
fn libraries(file: &Path, names: &[String], builder: &mut Builder) -> Result<HashMap<String, u32>> {
    let mut by_name = HashMap::new();
    let mut missing = Vec::new();
    let mut cache = TextureCache::default();
    let folder = path::folder(file);
    for (i, name) in names.iter().enumerate() {
        if names[..i].contains(name) {
            continue;
        }
        // A name may hold spaces, or the statement may list several files.
        let paths: Vec<(&str, std::result::Result<_, String>)> = match path::inside(folder, name) {
            Ok(path) => vec![(name, Ok(path))],
            Err(_) if name.contains(char::is_whitespace) => {
                name.split_whitespace().map(|n| (n, path::inside(folder, n))).collect()
            }
            Err(cause) => vec![(name, Err(cause))],
        };
        for (name, path) in paths {
            match path {
                Ok(path) => mtl::read(&path, builder, &mut cache, &mut by_name)?,
                Err(cause) => missing.push(format!("\"{name}\" ({cause})")),
            }
        }
    }
    if !missing.is_empty() {
        builder.warn(format!("{}: material libraries were not read: {}", file.display(), list(&missing, 5)));
    }
    if !cache.missing.is_empty() {
        builder.warn(format!(
            "{}: textures were not read, their factors count alone: {}",
            file.display(),
            list(&cache.missing, 5)
        ));
    }
    Ok(by_name)
}

/// Adds the materials that faces name and no library defines; `""` stands for faces that name none.
fn undefined_materials(runs: &[Run], builder: &mut Builder, materials: &mut HashMap<String, u32>) -> Vec<String> {
    let mut undefined = Vec::new();
    for run in runs {
        let key = run.material.as_deref().unwrap_or("");
        if !materials.contains_key(key) {
            let name = if key.is_empty() { "default" } else { key };
            let surface = Material { name: name.to_string(), albedo: DEFAULT_ALBEDO, ..Material::default() };
            materials.insert(key.to_string(), builder.add_material(RawMaterial { surface, ..RawMaterial::default() }));
            undefined.push(format!("\"{name}\""));
        }
    }
    undefined
}

fn to_mesh(mesh: tobj::Mesh, run: &Run, material: u32, repeated: &mut Vec<String>) -> RawMesh {
    let vec3 = |a: &[f64]| Vec3::new(a[0] as f32, a[1] as f32, a[2] as f32);
    let positions: Vec<DVec3> = mesh.positions.chunks_exact(3).map(DVec3::from_slice).collect();
    let (mut triangles, mut places) = (Vec::new(), Vec::new());
    let mut rest = &mesh.indices[..];
    for (face, &line) in run.lines.iter().enumerate() {
        let arity = mesh.face_arities.get(face).map_or(3, |a| *a as usize);
        let (corners, tail) = rest.split_at(arity.min(rest.len()));
        rest = tail;
        let points: Vec<DVec3> = corners.iter().map(|&i| positions[i as usize]).collect();
        let before = triangles.len();
        if arity > 3 && points.iter().all(|p| p.is_finite()) {
            let cut = polygon::triangulate(&points);
            if !cut.is_empty() && cut.len() + 2 < arity {
                repeated.push(format!("line {line}"));
            }
            triangles.extend(cut.into_iter().map(|t| t.map(|i| corners[i as usize])));
        }
        if triangles.len() == before {
            // What is not finite or has no area becomes a fan: it is counted and dropped with all else.
            triangles.extend((1..arity - 1).map(|i| [corners[0], corners[i], corners[i + 1]]));
        }
        places.resize(places.len() + triangles.len() - before, line);
    }
    RawMesh {
        name: run.name.clone(),
        normals: mesh.normals.chunks_exact(3).map(vec3).collect(),
        uvs: mesh.texcoords.chunks_exact(2).map(|a| Vec2::new(a[0] as f32, 1.0 - a[1] as f32)).collect(),
        colours: mesh.vertex_color.chunks_exact(3).map(vec3).collect(),
        positions,
        triangles,
        place: "line".into(),
        places,
        material,
    }
}
