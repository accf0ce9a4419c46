//! Where the rays of usual rows start and go, in a container: blocks `sets`, an array each.

use std::io::{self, Write};

use super::{Container, Name, Writer};
use crate::{Result, trace::RayTracer, transfer::PointSets};

const SETS: Name = Name::new("sets");

/// Writes `sets`.
///
/// # Errors
/// Those of the output.
pub fn write<W: Write>(out: &mut Writer<W>, sets: &PointSets) -> io::Result<()> {
    for (number, directions) in (0..).zip(&sets.directions) {
        out.array(SETS, number, directions)?;
    }
    out.array(SETS, 3, &sets.origin)?;
    out.array(SETS, 4, &sets.leading)
}

/// Reads what [`write()`] wrote of rows of so many rays, which `tracer` traces.
///
/// # Errors
/// Those of [`Container::array`]; [`Error::Input`](crate::Error::Input) if these are no sets of such rows.
pub fn read(file: &Container, rays: u32, tracer: &dyn RayTracer) -> Result<PointSets> {
    let directions = [file.array(SETS, 0)?, file.array(SETS, 1)?, file.array(SETS, 2)?];
    let (origin, leading) = (file.array(SETS, 3)?, file.array(SETS, 4)?);
    PointSets::of_arrays(rays as usize, tracer.traces_packets(), directions, origin, leading)
        .ok_or_else(|| file.wrong(SETS, 0, "is of other rows"))
}
