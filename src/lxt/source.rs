//! A scene as it was read, in a container: block `scene`.

use std::io::{self, Write};

use super::{Container, Name, Writer};
use crate::{Result, scene::Source};

pub(super) const SCENE: Name = Name::new("scene");

/// Writes the scene.
///
/// # Errors
/// Those of the output.
pub fn write<W: Write>(out: &mut Writer<W>, source: &Source) -> io::Result<()> {
    out.value(SCENE, 0, source)
}

/// Reads what [`write()`] wrote.
///
/// # Errors
/// Those of [`Container::value`]; [`Error::Input`](crate::Error::Input) if what is read does not fit together. What
/// [`Builder::build`](crate::scene::Builder::build) checks is not checked here.
pub fn read(file: &Container) -> Result<Source> {
    let source: Source = file.value(SCENE, 0)?;
    source.check().map_err(|e| file.wrong(SCENE, 0, &e))?;
    Ok(source)
}
