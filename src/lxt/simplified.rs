//! The simplified scene in a container: blocks `grid` and `geometry`, and `fragments` and `patches`, an array each.
//!
//! Colours of patches are not kept, since materials may change, nor is the table from hits to patches, which follows from
//! the fragments.

use std::io::{self, Write};

use super::{Container, Name, Writer};
use crate::{
    BakeOptions, Result, Scene,
    options::PatchSource,
    simplify::{self, Fragments, Grid, HitMap, Patches, Simplified},
    trace::Geometry,
};

const GRID: Name = Name::new("grid");
const GEOMETRY: Name = Name::new("geometry");
const FRAGMENTS: Name = Name::new("fragments");
const PATCHES: Name = Name::new("patches");

/// Writes all that [`read`] needs besides the scene and the options.
///
/// # Errors
/// Those of the output.
pub fn write<W: Write>(out: &mut Writer<W>, simplified: &Simplified, options: &BakeOptions) -> io::Result<()> {
    out.value(GRID, 0, &simplified.grid)?;
    if options.patches != PatchSource::Surfels {
        out.value(GEOMETRY, 0, &simplified.geometry)?;
    }
    write_pieces(out, simplified)
}

fn write_pieces<W: Write>(out: &mut Writer<W>, simplified: &Simplified) -> io::Result<()> {
    let Fragments { triangle, voxel, start, uv, patch } = &simplified.fragments;
    out.array(FRAGMENTS, 0, triangle)?;
    out.array(FRAGMENTS, 1, voxel)?;
    out.array(FRAGMENTS, 2, start)?;
    out.array(FRAGMENTS, 3, uv)?;
    out.array(FRAGMENTS, 4, patch)?;
    let Patches { area, centroid, eye, normal, albedo: _, emitted: _, voxel, start, members } = &simplified.patches;
    out.array(PATCHES, AREAS, area)?;
    out.array(PATCHES, 1, centroid)?;
    out.array(PATCHES, 2, eye)?;
    out.array(PATCHES, 3, normal)?;
    out.array(PATCHES, 4, voxel)?;
    out.array(PATCHES, 5, start)?;
    out.array(PATCHES, 6, members)
}

/// Number of the block of the patches' areas.
const AREAS: u64 = 0;

/// As [`write()`], for who has not got the scene: for [`read_alone`].
///
/// # Errors
/// Those of the output.
pub fn write_alone<W: Write>(out: &mut Writer<W>, simplified: &Simplified) -> io::Result<()> {
    out.value(GRID, 0, &simplified.grid)?;
    out.value(GEOMETRY, 0, &simplified.geometry)?;
    write_pieces(out, simplified)
}

/// Reads what [`write_alone`] wrote; the patches have no colours.
///
/// # Errors
/// Those of [`Container::value`]; [`Error::Input`](crate::Error::Input) if what is read does not fit together.
pub fn read_alone(file: &Container) -> Result<Simplified> {
    of_parts(file, file.value(GRID, 0)?, file.value(GEOMETRY, 0)?)
}

/// How many patches there are, without reading them.
pub fn count(file: &Container) -> usize {
    file.length(PATCHES, AREAS).unwrap_or(0) / size_of::<f32>()
}

/// The blocks that [`write()`] and [`write_alone`] have in common.
pub(super) const COMMON: [Name; 3] = [GRID, FRAGMENTS, PATCHES];

/// Reads what [`write()`] wrote of a scene with this geometry and these options; the patches have no colours yet.
///
/// # Errors
/// Those of [`Container::value`]; [`Error::Input`](crate::Error::Input) if what is read does not fit together, or not the
/// scene.
pub fn read(file: &Container, scene: &Scene, options: &BakeOptions) -> Result<Simplified> {
    let grid: Grid = file.value(GRID, 0)?;
    if grid != Grid::new(scene, options.resolution)? {
        return Err(file.wrong(GRID, 0, "is not the grid of the scene in this file"));
    }
    let own = options.patches != PatchSource::Surfels;
    of_parts(file, grid, if own { file.value(GEOMETRY, 0)? } else { scene.geometry() })
}

fn of_parts(file: &Container, grid: Grid, geometry: Geometry) -> Result<Simplified> {
    let fragments = Fragments {
        triangle: file.array(FRAGMENTS, 0)?,
        voxel: file.array(FRAGMENTS, 1)?,
        start: file.array(FRAGMENTS, 2)?,
        uv: file.array(FRAGMENTS, 3)?,
        patch: file.array(FRAGMENTS, 4)?,
    };
    let patches = Patches {
        area: file.array(PATCHES, AREAS)?,
        centroid: file.array(PATCHES, 1)?,
        eye: file.array(PATCHES, 2)?,
        normal: file.array(PATCHES, 3)?,
        voxel: file.array(PATCHES, 4)?,
        start: file.array(PATCHES, 5)?,
        members: file.array(PATCHES, 6)?,
        ..Patches::default()
    };
    simplify::check(&grid, &geometry, &fragments, &patches).map_err(|e| file.wrong(PATCHES, 0, &e))?;
    let hit_map = HitMap::new(&geometry, &fragments, &grid);
    Ok(Simplified { grid, geometry, fragments, patches, hit_map })
}
