//! EXR files through OpenEXRCore and the C shim in `ffi/`.
//!
//! What the shim relies on and this file ensures: strings end with zero, every plane has `width * height` values and
//! channels come sorted. A reader exists only while its file is open and header read.
#![allow(unsafe_code)]

use std::ffi::{CStr, CString, c_char};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::ptr::NonNull;

use super::{Compression, ExrAttribute, ExrChannel, ExrImage, check_size};
use crate::{Error, Result};

#[allow(non_camel_case_types, non_upper_case_globals, dead_code, missing_docs)]
mod ffi {
    include!(concat!(env!("CARGO_MANIFEST_DIR"), "/ffi/openexr_bindings.rs"));
}

type Message = [c_char; ffi::LUXEL_EXR_MESSAGE as usize];

const NO_MESSAGE: Message = [0; ffi::LUXEL_EXR_MESSAGE as usize];

/// An open file.
struct Reader {
    handle: NonNull<ffi::LuxelExrReader>,
    header: ffi::LuxelExrHeader,
}

impl Drop for Reader {
    fn drop(&mut self) {
        // SAFETY: the handle came from luxel_exr_open and is closed only here.
        unsafe { ffi::luxel_exr_close(self.handle.as_ptr()) }
    }
}

pub fn library() -> String {
    let (mut major, mut minor, mut patch) = (0, 0, 0);
    // SAFETY: three writable integers.
    unsafe { ffi::luxel_exr_version(&mut major, &mut minor, &mut patch) };
    format!("OpenEXRCore {major}.{minor}.{patch}")
}

/// What went wrong, in the library's words.
fn explain(code: i32, message: &Message) -> String {
    // SAFETY: the text is a static string of the library.
    let general = unsafe { CStr::from_ptr(ffi::luxel_exr_error_text(code)) }.to_string_lossy();
    // SAFETY: the shim ends every message by zero inside the array.
    let detail = unsafe { CStr::from_ptr(message.as_ptr()) }.to_string_lossy();
    if detail.is_empty() { general.into_owned() } else { detail.into_owned() }
}

fn c_string(text: &str) -> CString {
    // `check` refused texts with a zero inside; none is lost here.
    CString::new(text).unwrap_or_default()
}

fn c_path(path: &Path) -> Result<CString> {
    CString::new(path.as_os_str().as_bytes()).map_err(|e| Error::io(path, e.into()))
}

pub fn write(path: &Path, image: &ExrImage, compression: Compression) -> Result<()> {
    let channel_names: Vec<CString> = image.channels.iter().map(|c| c_string(&c.name)).collect();
    let channels: Vec<ffi::LuxelExrChannel> = image
        .channels
        .iter()
        .zip(&channel_names)
        .map(|(c, name)| ffi::LuxelExrChannel { name: name.as_ptr(), half: c.half, values: c.values.as_ptr() })
        .collect();
    let texts: Vec<(CString, Option<CString>, f32)> = image
        .attributes
        .iter()
        .map(|(name, value)| match value {
            ExrAttribute::Text(text) => (c_string(name), Some(c_string(text)), 0.0),
            ExrAttribute::Float(number) => (c_string(name), None, *number),
        })
        .collect();
    let attributes: Vec<ffi::LuxelExrAttribute> = texts
        .iter()
        .map(|(name, text, number)| ffi::LuxelExrAttribute {
            name: name.as_ptr(),
            text: text.as_ref().map_or(std::ptr::null(), |t| t.as_ptr()),
            length: text.as_ref().map_or(0, |t| t.as_bytes().len() as i32),
            number: *number,
        })
        .collect();
    let number = match compression {
        Compression::None => 0,
        Compression::Rle => 1,
        Compression::Zips => 2,
        Compression::Zip => 3,
        Compression::Piz => 4,
    };
    let c_path = c_path(path)?;
    let mut message = NO_MESSAGE;
    // SAFETY: all pointers lead into the vectors above, which outlive the call; `check` made sure that every channel
    // has width * height values and that both sides are below 2^24.
    let code = unsafe {
        ffi::luxel_exr_write(
            c_path.as_ptr(),
            image.width as i32,
            image.height as i32,
            number,
            channels.as_ptr(),
            channels.len() as i32,
            attributes.as_ptr(),
            attributes.len() as i32,
            message.as_mut_ptr(),
        )
    };
    if code != 0 {
        return Err(Error::Backend(format!("{}: {}", path.display(), explain(code, &message))));
    }
    Ok(())
}

/// None for files that this reader leaves to the other one.
pub fn read(path: &Path) -> Result<Option<ExrImage>> {
    let reader = open(path)?;
    let header = reader.header;
    if !header.readable {
        return Ok(None);
    }
    let (width, height) = (header.width as u32, header.height as u32);
    check_size(path, width as u64, height as u64, header.channel_count as u64)?;
    let pixels = width as usize * height as usize;
    let mut channels =
        (0..header.channel_count).map(|c| reader.channel(path, c, pixels)).collect::<Result<Vec<_>>>()?;
    let planes: Vec<*mut f32> = channels.iter_mut().map(|c| c.values.as_mut_ptr()).collect();
    let mut message = NO_MESSAGE;
    // SAFETY: one plane a channel, each with width * height values, all of this header.
    let code = unsafe { ffi::luxel_exr_read(reader.handle.as_ptr(), planes.as_ptr(), message.as_mut_ptr()) };
    if code != 0 {
        return Err(Error::input(path, "pixels", explain(code, &message)));
    }
    let attributes = (0..header.attribute_count).filter_map(|a| reader.attribute(a)).collect();
    Ok(Some(ExrImage { width, height, channels, attributes }))
}

fn open(path: &Path) -> Result<Reader> {
    let c_path = c_path(path)?;
    let mut handle = std::ptr::null_mut();
    let mut header = ffi::LuxelExrHeader { width: 0, height: 0, channel_count: 0, attribute_count: 0, readable: false };
    let mut message = NO_MESSAGE;
    // SAFETY: the path ends with zero, the rest is writable and lives on this stack.
    let code = unsafe { ffi::luxel_exr_open(c_path.as_ptr(), &mut handle, &mut header, message.as_mut_ptr()) };
    match NonNull::new(handle) {
        Some(handle) if code == 0 => Ok(Reader { handle, header }),
        _ => Err(Error::input(path, "header", explain(code, &message))),
    }
}

impl Reader {
    fn channel(&self, path: &Path, index: i32, pixels: usize) -> Result<ExrChannel> {
        let mut out = ffi::LuxelExrChannel { name: std::ptr::null(), half: false, values: std::ptr::null() };
        // SAFETY: the reader is open; the shim checks the index.
        let code = unsafe { ffi::luxel_exr_channel(self.handle.as_ptr(), index, &mut out) };
        if code != 0 || out.name.is_null() {
            return Err(Error::input(path, "header", explain(code, &NO_MESSAGE)));
        }
        // SAFETY: the name is not null, ends with zero and stays valid while the reader is open.
        let name = unsafe { CStr::from_ptr(out.name) }.to_string_lossy().into_owned();
        // Asked for politely first: running out of memory must be an error, not an abort.
        let room: std::result::Result<(), _> = Vec::<f32>::new().try_reserve_exact(pixels);
        room.map_err(|e| Error::input(path, "header", format!("{pixels} pixels: {e}")))?;
        Ok(ExrChannel { name, half: out.half, values: vec![0.0; pixels] })
    }

    /// None for kinds other than text and float, and for the attributes of the format itself.
    fn attribute(&self, index: i32) -> Option<(String, ExrAttribute)> {
        let mut out = ffi::LuxelExrAttribute { name: std::ptr::null(), text: std::ptr::null(), length: 0, number: 0.0 };
        // SAFETY: the reader is open; the library checks the index.
        let code = unsafe { ffi::luxel_exr_attribute(self.handle.as_ptr(), index, &mut out) };
        if code != 0 || out.name.is_null() {
            return None;
        }
        // SAFETY: the name is not null, ends with zero and stays valid while the reader is open.
        let name = unsafe { CStr::from_ptr(out.name) }.to_string_lossy().into_owned();
        if super::REQUIRED.contains(&name.as_str()) {
            return None;
        }
        let value = if out.text.is_null() {
            ExrAttribute::Float(out.number)
        } else {
            // SAFETY: the shim hands out `length` >= 0 bytes that stay valid while the reader is open.
            let bytes = unsafe { std::slice::from_raw_parts(out.text.cast::<u8>(), out.length as usize) };
            ExrAttribute::Text(String::from_utf8_lossy(bytes).into_owned())
        };
        Some((name, value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn structs_have_the_sizes_that_c_says_they_have() {
        let mut sizes = [0usize; 3];
        // SAFETY: three writable numbers.
        unsafe { ffi::luxel_exr_sizes(sizes.as_mut_ptr()) };
        assert_eq!(sizes[0], size_of::<ffi::LuxelExrHeader>());
        assert_eq!(sizes[1], size_of::<ffi::LuxelExrChannel>());
        assert_eq!(sizes[2], size_of::<ffi::LuxelExrAttribute>());
    }
}
