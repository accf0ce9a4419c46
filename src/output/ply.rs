//! Binary little-endian PLY: the split mesh with its light, and the patches.

use std::io::{self, Write};

use glam::{DVec3, Vec3};

use super::tonemap::ToneMap;
use crate::{
    bake::{Irradiance, PatchLight},
    estimate::VertexError,
    sampling,
    scene::Frame,
    simplify::{Patches, SplitMesh},
};

/// Single-precision coordinates may be off by at most this share of a voxel; else they are written in double.
const ROUNDING: f64 = 1e-3;

/// Writes the split mesh in world coordinates. Each vertex has `x y z nx ny nz`, irradiance `direct_r/g/b` and
/// `indirect_r/g/b` in W/m2, and `albedo_r/g/b`; with `error` also `error_direct`, `error_indirect` and `error`, the
/// standard errors of the luminance of direct, indirect and all irradiance, W/m2.
///
/// Coordinates are `float`, or `double` where float would move them by a thousandth of `voxel_size` (world).
///
/// # Errors
/// Those of `out`.
pub fn write_vertices(
    out: &mut dyn Write,
    mesh: &SplitMesh,
    light: &Irradiance,
    error: Option<&VertexError>,
    frame: &Frame,
    voxel_size: f64,
) -> io::Result<()> {
    let coordinates = Coordinates::choose(&mesh.positions, frame, voxel_size);
    writeln!(out, "ply\nformat binary_little_endian 1.0\ncomment luxel: irradiance in W/m2, linear RGB")?;
    writeln!(out, "element vertex {}", mesh.positions.len())?;
    coordinates.declare(out)?;
    declare(out, "float", &["nx", "ny", "nz"])?;
    for name in ["direct", "indirect", "albedo"] {
        declare_rgb(out, name)?;
    }
    if error.is_some() {
        declare(out, "float", &["error_direct", "error_indirect", "error"])?;
    }
    writeln!(out, "element face {}\nproperty list uchar uint vertex_indices\nend_header", mesh.triangles.len())?;
    for (i, &position) in mesh.positions.iter().enumerate() {
        coordinates.write(out, frame.to_world(position))?;
        for values in [mesh.normals[i], light.direct[i], light.indirect[i], mesh.albedo[i]] {
            write_vec3(out, values)?;
        }
        if let Some(e) = error {
            write_vec3(out, Vec3::new(e.direct[i], e.indirect[i], e.total[i]))?;
        }
    }
    mesh.triangles.iter().try_for_each(|t| write_indices(out, t))
}

/// What a patch file shows.
pub struct PatchFile<'a> {
    /// The split mesh.
    pub mesh: &'a SplitMesh,
    /// The patches.
    pub patches: &'a Patches,
    /// Their light.
    pub light: &'a PatchLight,
    /// Local frame.
    pub frame: &'a Frame,
    /// Voxel size, world.
    pub voxel_size: f64,
    /// For the 8-bit colours.
    pub tone: ToneMap,
    /// Whether the patches are voxel faces: squares of their own, instead of groups of the mesh's triangles.
    pub squares: bool,
}

impl PatchFile<'_> {
    /// Writes the patches. Each face has `patch` (-1: none), `radiosity_r/g/b` in W/m2 and `albedo_r/g/b` of its patch,
    /// the patch's `area` (world), and `red green blue`: its radiance as a display shows it, so that mesh viewers
    /// show the flat patches.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let corners = if self.squares { self.square_corners() } else { self.mesh.positions.clone() };
        let faces = if self.squares { self.patches.len() } else { self.mesh.triangles.len() };
        let coordinates = Coordinates::choose(&corners, self.frame, self.voxel_size);
        writeln!(out, "ply\nformat binary_little_endian 1.0\ncomment luxel: radiosity in W/m2, linear RGB")?;
        writeln!(out, "element vertex {}", corners.len())?;
        coordinates.declare(out)?;
        writeln!(out, "element face {faces}\nproperty list uchar uint vertex_indices")?;
        declare(out, "int", &["patch"])?;
        declare_rgb(out, "radiosity")?;
        declare_rgb(out, "albedo")?;
        declare(out, "float", &["area"])?;
        declare(out, "uchar", &["red", "green", "blue"])?;
        writeln!(out, "end_header")?;
        for &corner in &corners {
            coordinates.write(out, self.frame.to_world(corner))?;
        }
        for face in 0..faces {
            if self.squares {
                let first = 4 * face as u32;
                write_indices(out, &[first, first + 1, first + 2, first + 3])?;
                self.write_patch(out, face)?;
            } else {
                write_indices(out, &self.mesh.triangles[face])?;
                self.write_patch(out, self.mesh.patch[face] as usize)?;
            }
        }
        Ok(())
    }

    fn write_patch(&self, out: &mut dyn Write, patch: usize) -> io::Result<()> {
        let (id, radiosity, albedo, area) = if patch < self.patches.len() {
            let area = self.patches.area[patch] as f64 * self.frame.scale * self.frame.scale;
            (patch as i32, self.light.radiosity[patch], self.patches.albedo[patch], area as f32)
        } else {
            (-1, Vec3::ZERO, Vec3::ZERO, 0.0)
        };
        out.write_all(&id.to_le_bytes())?;
        write_vec3(out, radiosity)?;
        write_vec3(out, albedo)?;
        out.write_all(&area.to_le_bytes())?;
        out.write_all(&self.tone.srgb8(radiosity / std::f32::consts::PI))
    }

    /// Four corners a voxel face, anticlockwise seen against its normal.
    fn square_corners(&self) -> Vec<Vec3> {
        (0..self.patches.len())
            .flat_map(|i| {
                let half = 0.5 * self.patches.area[i].sqrt();
                let (u, v) = sampling::frame(self.patches.normal[i]);
                [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                    .map(|(a, b)| self.patches.centroid[i] + half * (a * u + b * v))
            })
            .collect()
    }
}

/// How world coordinates are stored.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Coordinates {
    Float,
    Double,
}

impl Coordinates {
    fn choose(positions: &[Vec3], frame: &Frame, voxel_size: f64) -> Coordinates {
        let largest =
            positions.iter().map(|p| frame.to_world(*p).abs().max_element()).fold(0.0, f64::max) * f32::EPSILON as f64;
        if largest > ROUNDING * voxel_size { Coordinates::Double } else { Coordinates::Float }
    }

    fn declare(self, out: &mut dyn Write) -> io::Result<()> {
        declare(out, if self == Coordinates::Float { "float" } else { "double" }, &["x", "y", "z"])
    }

    fn write(self, out: &mut dyn Write, world: DVec3) -> io::Result<()> {
        match self {
            Coordinates::Float => write_vec3(out, world.as_vec3()),
            Coordinates::Double => world.to_array().iter().try_for_each(|x| out.write_all(&x.to_le_bytes())),
        }
    }
}

fn declare(out: &mut dyn Write, kind: &str, names: &[&str]) -> io::Result<()> {
    names.iter().try_for_each(|name| writeln!(out, "property {kind} {name}"))
}

fn declare_rgb(out: &mut dyn Write, name: &str) -> io::Result<()> {
    ["r", "g", "b"].iter().try_for_each(|channel| writeln!(out, "property float {name}_{channel}"))
}

fn write_vec3(out: &mut dyn Write, v: Vec3) -> io::Result<()> {
    v.to_array().iter().try_for_each(|x| out.write_all(&x.to_le_bytes()))
}

fn write_indices(out: &mut dyn Write, indices: &[u32]) -> io::Result<()> {
    out.write_all(&[indices.len() as u8])?;
    indices.iter().try_for_each(|i| out.write_all(&i.to_le_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of two triangles, its own light at every corner; triangle 0 is patch 0, triangle 1 belongs to none.
    fn square() -> (SplitMesh, Irradiance) {
        let corner = |x, y| Vec3::new(x, y, 0.25);
        let ramp = |k: f32| (0..4).map(|i| Vec3::new(k, i as f32, 0.5)).collect::<Vec<_>>();
        let mesh = SplitMesh {
            positions: vec![corner(0.0, 0.0), corner(0.5, 0.0), corner(0.5, 0.5), corner(0.0, 0.5)],
            normals: vec![Vec3::Z; 4],
            albedo: ramp(0.75),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            source: vec![0, 0],
            patch: vec![0, u32::MAX],
            ..Default::default()
        };
        (mesh, Irradiance { direct: ramp(10.0), indirect: ramp(20.0) })
    }

    /// Name, count, (type, name) of every property.
    type Element = (String, usize, Vec<(String, String)>);

    /// A reader of PLY's header: the elements in order, and where the data starts.
    fn header(file: &[u8]) -> (Vec<Element>, usize) {
        let end = file.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let text = std::str::from_utf8(&file[..end]).unwrap();
        assert!(text.starts_with("ply\nformat binary_little_endian 1.0\n"));
        let mut elements: Vec<Element> = Vec::new();
        for line in text.lines() {
            match line.split(' ').collect::<Vec<_>>()[..] {
                ["element", name, count] => elements.push((name.into(), count.parse().unwrap(), Vec::new())),
                ["property", kind, name] => elements.last_mut().unwrap().2.push((kind.into(), name.into())),
                ["property", "list", "uchar", "uint", name] => {
                    elements.last_mut().unwrap().2.push(("list".into(), name.into()))
                }
                _ => {}
            }
        }
        (elements, end)
    }

    fn floats(bytes: &[u8]) -> Vec<f32> {
        bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
    }

    const FRAME: Frame = Frame { origin: DVec3::new(10.0, 20.0, 30.0), scale: 4.0 };

    #[test]
    fn vertices_are_in_the_world_with_their_light() {
        let (mesh, light) = square();
        let mut file = Vec::new();
        write_vertices(&mut file, &mesh, &light, None, &FRAME, 0.1).unwrap();
        let (elements, start) = header(&file);
        let (name, count, properties) = &elements[0];
        assert_eq!((name.as_str(), *count, properties.len()), ("vertex", 4, 15));
        assert!(properties.iter().all(|(kind, _)| kind == "float"));
        let data = floats(&file[start..start + 4 * 60]);
        let vertex = |i: usize, name: &str| data[15 * i + properties.iter().position(|(_, n)| n == name).unwrap()];
        assert_eq!([vertex(2, "x"), vertex(2, "y"), vertex(2, "z")], [12.0, 22.0, 31.0]);
        assert_eq!(vertex(2, "nz"), 1.0);
        assert_eq!([vertex(3, "direct_r"), vertex(3, "direct_g"), vertex(3, "indirect_r")], [10.0, 3.0, 20.0]);
        assert_eq!(vertex(1, "albedo_r"), 0.75);
        let faces = &file[start + 240..];
        assert_eq!(faces.len(), 2 * 13);
        assert_eq!((faces[13], &faces[14..26]), (3, bytemuck::cast_slice(&[0u32, 2, 3])));
    }

    #[test]
    fn errors_stand_behind_the_light_that_they_are_of() {
        let (mesh, light) = square();
        let column = |k: f32| (0..4).map(|i| k + i as f32).collect::<Vec<f32>>();
        let error = VertexError { direct: column(10.0), indirect: column(20.0), total: column(30.0) };
        let mut file = Vec::new();
        write_vertices(&mut file, &mesh, &light, Some(&error), &FRAME, 0.1).unwrap();
        let (elements, start) = header(&file);
        let names: Vec<&str> = elements[0].2[15..].iter().map(|(_, name)| name.as_str()).collect();
        assert_eq!(names, ["error_direct", "error_indirect", "error"]);
        assert_eq!(floats(&file[start + 2 * 72 + 60..start + 3 * 72]), [12.0, 22.0, 32.0]);
    }

    #[test]
    fn coordinates_far_from_the_origin_are_written_in_double() {
        let (mesh, light) = square();
        let far = Frame { origin: DVec3::new(1e7, 0.0, 0.0), scale: 4.0 };
        let mut file = Vec::new();
        write_vertices(&mut file, &mesh, &light, None, &far, 0.1).unwrap();
        let (elements, start) = header(&file);
        assert_eq!(elements[0].2[0], ("double".to_string(), "x".to_string()));
        let x = |i: usize| f64::from_le_bytes(file[start + 72 * i..][..8].try_into().unwrap());
        assert_eq!([x(0), x(1)], [1e7, 1e7 + 2.0]);
    }

    fn one_patch() -> (Patches, PatchLight) {
        let patches = Patches {
            area: vec![0.25].into(),
            centroid: vec![Vec3::new(0.25, 0.25, 0.25)].into(),
            normal: vec![Vec3::Z].into(),
            albedo: vec![Vec3::splat(0.5)],
            emitted: vec![Vec3::ZERO],
            ..Default::default()
        };
        let light = PatchLight { radiosity: vec![Vec3::splat(std::f32::consts::PI)], ..Default::default() };
        (patches, light)
    }

    fn patch_file(squares: bool) -> Vec<u8> {
        let ((mesh, _), (patches, light)) = (square(), one_patch());
        let tone = ToneMap { exposure: 0.5 };
        let mut file = Vec::new();
        PatchFile { mesh: &mesh, patches: &patches, light: &light, frame: &FRAME, voxel_size: 0.1, tone, squares }
            .write(&mut file)
            .unwrap();
        file
    }

    #[test]
    fn triangles_carry_the_light_of_their_patch() {
        let file = patch_file(false);
        let (elements, start) = header(&file);
        assert_eq!((elements[1].1, elements[1].2.len()), (2, 12));
        let faces = &file[start + 4 * 12..];
        let row = 13 + 4 + 12 + 12 + 4 + 3;
        assert_eq!(faces.len(), 2 * row);
        assert_eq!(faces[13..17], 0i32.to_le_bytes());
        assert_eq!(floats(&faces[17..45]), [[std::f32::consts::PI; 3].as_slice(), &[0.5; 3], &[4.0]].concat());
        // Radiance 1 at exposure 0.5 is linear 0.5: sRGB 188.
        assert_eq!(faces[45..48], [188; 3]);
        assert_eq!(faces[row + 13..row + 17], (-1i32).to_le_bytes());
        assert_eq!(faces[row + 17..], [0; 31]);
    }

    #[test]
    fn voxel_faces_are_squares_that_face_along_their_normal() {
        let file = patch_file(true);
        let (elements, start) = header(&file);
        assert_eq!((elements[0].1, elements[1].1), (4, 1));
        let c: Vec<Vec3> = floats(&file[start..start + 48]).as_chunks::<3>().0.iter().map(|p| Vec3::from(*p)).collect();
        // The local square 0 ..= 0.5 at z = 0.25, in the world; area 4, so |cross of its diagonals| = 8.
        assert_eq!((c[2] - c[0]).cross(c[3] - c[1]), Vec3::Z * 8.0);
        assert_eq!((c[0] + c[2]) * 0.5, Vec3::new(11.0, 21.0, 31.0));
        assert_eq!(file[start + 48], 4);
    }
}
