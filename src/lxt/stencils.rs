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

#[derive(Serialize, Deserialize)]
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

/// Writes the stencils.
///
/// # Errors
/// Those of the output.
pub fn write<W: Write>(out: &mut Writer<W>, stencils: &Stencils) -> io::Result<()> {
    let (points, ends, neighbours) = stencils.parts();
    let numbers = |p: &SurfacePoint| {
        let ([a, b, c], [d, e, f]) = (p.position.to_array(), p.normal.to_array());
        [a, b, c, d, e, f]
    };
    let points = points.iter().map(numbers).collect();
    out.value(STENCILS, 0, &Parts { points, ends: ends.to_vec(), neighbours: neighbours.to_vec() })
}

/// Reads what [`write()`] wrote, of a scene with so many patches.
///
/// # Errors
/// Those of [`Container::value`]; [`Error::Input`](crate::Error::Input) if the stencils are wrong.
pub fn read(file: &Container, patches: usize) -> Result<Stencils> {
    let Parts { points, ends, neighbours } = file.value(STENCILS, 0)?;
    let runs = points.len() == ends.len()
        && ends.is_sorted()
        && ends.last().map_or(0, |&end| end as usize) == neighbours.len();
    let sound = |n: &Neighbour| (n.patch as usize) < patches && n.weight.is_finite() && n.weight > 0.0;
    if !runs || !neighbours.iter().all(sound) {
        return Err(file.wrong(STENCILS, 0, "its points and patches do not fit together"));
    }
    let point = |[a, b, c, d, e, f]: [f32; 6]| SurfacePoint { position: [a, b, c].into(), normal: [d, e, f].into() };
    Ok(Stencils::of(points.into_iter().map(point).collect(), ends, neighbours))
}
