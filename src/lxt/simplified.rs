//! The simplified scene in a container: blocks `grid`, `geometry`, `fragments`, `patches`.
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
    out.value(FRAGMENTS, 0, &simplified.fragments)?;
    out.value(PATCHES, 0, &simplified.patches)
}

/// As [`write()`], for who has not got the scene: for [`read_alone`].
///
/// # Errors
/// Those of the output.
pub fn write_alone<W: Write>(out: &mut Writer<W>, simplified: &Simplified) -> io::Result<()> {
    out.value(GRID, 0, &simplified.grid)?;
    out.value(GEOMETRY, 0, &simplified.geometry)?;
    out.value(FRAGMENTS, 0, &simplified.fragments)?;
    out.value(PATCHES, 0, &simplified.patches)
}

/// Reads what [`write_alone`] wrote; the patches have no colours.
///
/// # Errors
/// Those of [`Container::value`]; [`Error::Input`](crate::Error::Input) if what is read does not fit together.
pub fn read_alone(file: &Container) -> Result<Simplified> {
    of_parts(file, file.value(GRID, 0)?, file.value(GEOMETRY, 0)?)
}

/// How many patches there are, without reading them.
///
/// # Errors
/// Those of [`Container::value`].
pub fn count(file: &Container) -> Result<usize> {
    // Their areas come first, after the length of these in bytes.
    match postcard::take_from_bytes::<usize>(&file.block(PATCHES, 0)?) {
        Ok((bytes, _)) => Ok(bytes / size_of::<f32>()),
        Err(e) => Err(file.wrong(PATCHES, 0, &format!("cannot be understood ({e})"))),
    }
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
    let fragments: Fragments = file.value(FRAGMENTS, 0)?;
    let patches: Patches = file.value(PATCHES, 0)?;
    simplify::check(&grid, &geometry, &fragments, &patches).map_err(|e| file.wrong(PATCHES, 0, &e))?;
    let hit_map = HitMap::new(&geometry, &fragments, &grid);
    Ok(Simplified { grid, geometry, fragments, patches, hit_map })
}
