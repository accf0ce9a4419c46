//! Which patches vertices take their light from, in a container: block `stencils`.

use std::io::{self, Write};

use serde::{Deserialize, Serialize};

use super::{Container, Name, Writer};
use crate::{
    Result,
    reconstruct::{Neighbour, Stencils},
    scene::SurfacePoint,
};

const STENCILS: Name = Name::new("stencils");
const POINTS: Name = Name::new("points");

#[derive(Deserialize)]
struct Parts {
    /// Position and normal of every point.
    #[serde(with = "super::raw")]
    points: Vec<[f32; 6]>,
    /// Where the neighbours of each end.
    #[serde(with = "super::raw")]
    ends: Vec<u32>,
    #[serde(with = "super::raw")]
    neighbours: Vec<Neighbour>,
}

/// The same, not copied.
#[derive(Serialize)]
struct View<'a> {
    #[serde(serialize_with = "super::raw::serialize")]
    points: &'a [[f32; 6]],
    #[serde(serialize_with = "super::raw::serialize")]
    ends: &'a [u32],
    #[serde(serialize_with = "super::raw::serialize")]
    neighbours: &'a [Neighbour],
}

/// Writes the stencils.
///
/// # Errors
/// Those of the output.
pub fn write<W: Write>(out: &mut Writer<W>, stencils: &Stencils) -> io::Result<()> {
    let (points, ends, neighbours) = stencils.parts();
    let points: Vec<[f32; 6]> = points.iter().map(numbers).collect();
    out.value(STENCILS, 0, &View { points: &points, ends, neighbours })
}

/// Writes stencils of points that stand elsewhere: see [`write_points`].
///
/// # Errors
/// Those of the output.
pub fn write_alone<W: Write>(out: &mut Writer<W>, stencils: &Stencils) -> io::Result<()> {
    let (_, ends, neighbours) = stencils.parts();
    out.value(STENCILS, 0, &View { points: &[], ends, neighbours })
}

/// Writes some points as block `number` of `points`.
///
/// # Errors
/// Those of the output.
pub fn write_points<W: Write>(out: &mut Writer<W>, number: u64, points: &[SurfacePoint]) -> io::Result<()> {
    let numbers: Vec<[f32; 6]> = points.iter().map(numbers).collect();
    out.array(POINTS, number, &numbers)
}

/// How many points [`write_points`] wrote, by the length of the block; none if it is not there.
pub fn count_points(file: &Container, number: u64) -> usize {
    file.length(POINTS, number).unwrap_or(0) / size_of::<[f32; 6]>()
}

/// Reads what [`write_points`] wrote.
///
/// # Errors
/// Those of [`Container::array`].
pub fn read_points(file: &Container, number: u64) -> Result<Vec<SurfacePoint>> {
    Ok(file.array(POINTS, number)?.iter().copied().map(point).collect())
}

fn numbers(point: &SurfacePoint) -> [f32; 6] {
    let ([a, b, c], [d, e, f]) = (point.position.to_array(), point.normal.to_array());
    [a, b, c, d, e, f]
}

fn point([a, b, c, d, e, f]: [f32; 6]) -> SurfacePoint {
    SurfacePoint { position: [a, b, c].into(), normal: [d, e, f].into() }
}

/// Reads what [`write()`] wrote, of a scene with so many patches.
///
/// # Errors
/// Those of [`Container::value`]; [`Error::Input`](crate::Error::Input) if the stencils are wrong.
pub fn read(file: &Container, patches: usize) -> Result<Stencils> {
    let Parts { points, ends, neighbours } = file.value(STENCILS, 0)?;
    checked(file, points.into_iter().map(point).collect(), ends, neighbours, patches)
}

/// Reads what [`write_alone`] wrote of `points`, of a scene with so many patches.
///
/// # Errors
/// As of [`read`].
pub fn read_alone(file: &Container, points: Vec<SurfacePoint>, patches: usize) -> Result<Stencils> {
    let Parts { ends, neighbours, .. } = file.value(STENCILS, 0)?;
    checked(file, points, ends, neighbours, patches)
}

fn checked(
    file: &Container,
    points: Vec<SurfacePoint>,
    ends: Vec<u32>,
    neighbours: Vec<Neighbour>,
    patches: usize,
) -> Result<Stencils> {
    let runs = points.len() == ends.len()
        && ends.is_sorted()
        && ends.last().map_or(0, |&end| end as usize) == neighbours.len();
    let sound = |n: &Neighbour| (n.patch as usize) < patches && n.weight.is_finite() && n.weight > 0.0;
    if !runs || !neighbours.iter().all(sound) {
        return Err(file.wrong(STENCILS, 0, "its points and patches do not fit together"));
    }
    Ok(Stencils::of(points, ends, neighbours))
}
