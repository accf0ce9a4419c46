//! OpenEXR images: named channels of floats or half floats, with text and number attributes.
//!
//! With the feature `openexr` the system's OpenEXRCore reads and writes, without it the `exr` crate. The crate is
//! always there: it reads what the native reader leaves out (tiles, several parts, integer channels).

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use crate::{Error, Result};

#[cfg(feature = "openexr")]
#[path = "exr_native.rs"]
mod native;
#[path = "exr_pure.rs"]
mod pure;

/// An image, or the first part of a file with several.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExrImage {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Channels, in any order when written and sorted by name when read.
    pub channels: Vec<ExrChannel>,
    /// Attributes beyond those of the format itself. When read: the ones with text or a number, sorted by name.
    pub attributes: Vec<(String, ExrAttribute)>,
}

/// One value a pixel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExrChannel {
    /// `R`, or `layer.R`.
    pub name: String,
    /// Whether the file stores 16-bit floats: 11 significant bits, nothing above 65504.
    pub half: bool,
    /// `width * height` values, row by row from the top.
    pub values: Vec<f32>,
}

/// The value of an attribute.
#[derive(Clone, Debug, PartialEq)]
pub enum ExrAttribute {
    /// Text.
    Text(String),
    /// A number.
    Float(f32),
}

/// How pixels are packed; all of these are lossless.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// zlib over 16 rows at a time.
    #[default]
    Zip,
    /// zlib over single rows.
    Zips,
    /// Run lengths.
    Rle,
    /// Wavelets.
    Piz,
    /// Not at all.
    None,
}

/// No file holds more samples than its size can unpack to: zlib packs at most 1032 : 1, and headers take room.
const MOST_BYTES_PER_BYTE: u64 = 2048;

/// Samples of all channels together: 16 GiB once read.
const MOST_SAMPLES: u64 = 1 << 32;

/// Texts and numbers that belong to the format, not to the user.
const REQUIRED: [&str; 5] = ["name", "type", "view", "pixelAspectRatio", "screenWindowWidth"];

/// Names longer than this do not fit the format.
const LONGEST_NAME: usize = 255;

/// Name and version of the library that writes.
pub fn library() -> String {
    #[cfg(feature = "openexr")]
    return native::library();
    #[cfg(not(feature = "openexr"))]
    pure::library()
}

/// Writes `image` to `path`: first under another name in the same folder, which then takes the place of `path` in
/// one step, so that there is never half a file. In case of an error nothing is left behind.
///
/// # Errors
/// [`Error::Option`] if the image is not consistent, [`Error::Io`] or [`Error::Backend`] if it cannot be written.
pub fn write(path: &Path, image: &ExrImage, compression: Compression) -> Result<()> {
    #[cfg(feature = "openexr")]
    return write_with(path, image, compression, native::write);
    #[cfg(not(feature = "openexr"))]
    write_with(path, image, compression, pure::write)
}

/// Reads `path`.
///
/// # Errors
/// [`Error::Io`] if there is no such file, [`Error::Input`] if it is no image, or promises more than it can hold.
pub fn read(path: &Path) -> Result<ExrImage> {
    check_magic(path)?;
    #[cfg(feature = "openexr")]
    if let Some(image) = native::read(path)? {
        return Ok(sorted(image));
    }
    pure::read(path).map(sorted)
}

fn write_with(
    path: &Path,
    image: &ExrImage,
    compression: Compression,
    backend: impl Fn(&Path, &ExrImage, Compression) -> Result<()>,
) -> Result<()> {
    let image = sorted(image.clone());
    check(path, &image)?;
    let temporary = temporary_name(path)?;
    let written = backend(&temporary, &image, compression).and_then(|()| {
        // Data before name: after a crash the name must not lead to an empty file.
        let synced = File::open(&temporary).and_then(|file| file.sync_all());
        synced.and_then(|()| fs::rename(&temporary, path)).map_err(|e| Error::io(path, e))
    });
    if written.is_err() {
        // The first error counts; the file may not even exist.
        let _ = fs::remove_file(&temporary);
    }
    written
}

/// `.NAME.PROCESS-COUNT.tmp` beside `path`.
fn temporary_name(path: &Path) -> Result<PathBuf> {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let missing = || Error::io(path, std::io::ErrorKind::IsADirectory.into());
    let mut name = std::ffi::OsString::from(".");
    name.push(path.file_name().ok_or_else(missing)?);
    name.push(format!(".{}-{}.tmp", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed)));
    Ok(path.with_file_name(name))
}

fn sorted(mut image: ExrImage) -> ExrImage {
    image.channels.sort_by(|a, b| a.name.cmp(&b.name));
    image.attributes.sort_by(|a, b| a.0.cmp(&b.0));
    image
}

/// Finds what the libraries would not write, or write wrongly.
fn check(path: &Path, image: &ExrImage) -> Result<()> {
    let fail = |what: String| Err(Error::Option(format!("{}: {what}", path.display())));
    let side = 1..=1 << 24;
    if !side.contains(&image.width) || !side.contains(&image.height) {
        return fail(format!("an image of {} x {} pixels cannot be written", image.width, image.height));
    }
    if image.channels.is_empty() {
        return fail("an image without channels cannot be written".into());
    }
    let pixels = image.width as usize * image.height as usize;
    for channel in &image.channels {
        if channel.values.len() != pixels {
            return fail(format!("channel {} has {} values for {pixels} pixels", channel.name, channel.values.len()));
        }
    }
    let channels = image.channels.iter().map(|c| &c.name);
    let attributes = image.attributes.iter().map(|a| &a.0);
    for name in channels.chain(attributes) {
        if name.is_empty() || REQUIRED.contains(&name.as_str()) || name.len() > LONGEST_NAME || name.contains('\0') {
            return fail(format!("{name:?} cannot be the name of a channel or attribute"));
        }
    }
    // Both lists are sorted.
    let channel = image.channels.windows(2).find(|w| w[0].name == w[1].name).map(|w| &w[0].name);
    let attribute = image.attributes.windows(2).find(|w| w[0].0 == w[1].0).map(|w| &w[0].0);
    if let Some(name) = channel.or(attribute) {
        return fail(format!("{name:?} occurs twice"));
    }
    for (name, value) in &image.attributes {
        if matches!(value, ExrAttribute::Text(text) if text.contains('\0') || text.len() > i32::MAX as usize) {
            return fail(format!("the text of attribute {name} cannot be written"));
        }
    }
    Ok(())
}

fn check_magic(path: &Path) -> Result<()> {
    let mut start = [0; 4];
    let read = File::open(path).and_then(|mut file| file.read(&mut start)).map_err(|e| Error::io(path, e))?;
    if read < 4 || start != [0x76, 0x2f, 0x31, 0x01] {
        return Err(Error::input(path, "", "this is not an OpenEXR file"));
    }
    Ok(())
}

/// Refuses headers that promise more than the file can hold, before memory is asked for.
fn check_size(path: &Path, width: u64, height: u64, channels: u64) -> Result<()> {
    let size = fs::metadata(path).map_err(|e| Error::io(path, e))?.len();
    let samples = width.checked_mul(height).and_then(|pixels| pixels.checked_mul(channels)).unwrap_or(u64::MAX);
    if samples > MOST_SAMPLES || samples > size.saturating_mul(MOST_BYTES_PER_BYTE) {
        let promise = format!("{width} x {height} pixels with {channels} channels");
        return Err(Error::input(path, "header", format!("{promise} do not fit a file of {size} bytes")));
    }
    Ok(())
}

#[cfg(test)]
#[path = "exr_tests.rs"]
mod tests;
