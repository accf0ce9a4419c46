//! EXR files through the `exr` crate: pure Rust.

#[cfg(any(test, not(feature = "openexr")))]
use std::{fs, io::Cursor};
use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
};

use exr::meta::{MetaData, header::LayerAttributes};
use exr::prelude::*;

#[cfg(any(test, not(feature = "openexr")))]
use super::Compression;
use super::{ExrAttribute, ExrChannel, ExrImage, check_size};
use crate::{Error, Result};

#[cfg(any(test, not(feature = "openexr")))]
pub fn library() -> String {
    "exr 1.74 (Rust)".into()
}

#[cfg(any(test, not(feature = "openexr")))]
pub fn write(path: &Path, image: &ExrImage, compression: Compression) -> Result<()> {
    let channel = |c: &ExrChannel| {
        let samples = match c.half {
            true => FlatSamples::F16(c.values.iter().map(|&x| f16::from_f32(x)).collect()),
            false => FlatSamples::F32(c.values.clone()),
        };
        AnyChannel::new(Text::from_slice_unchecked(c.name.as_bytes()), samples)
    };
    let mut attributes = LayerAttributes::default();
    for (name, value) in &image.attributes {
        insert(&mut attributes, name, value);
    }
    let encoding = Encoding {
        compression: match compression {
            Compression::Zip => exr::prelude::Compression::ZIP16,
            Compression::Zips => exr::prelude::Compression::ZIP1,
            Compression::Rle => exr::prelude::Compression::RLE,
            Compression::Piz => exr::prelude::Compression::PIZ,
            Compression::None => exr::prelude::Compression::Uncompressed,
        },
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let channels = AnyChannels::sort(image.channels.iter().map(channel).collect());
    let layer = Layer::new((image.width as usize, image.height as usize), attributes, encoding, channels);
    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut bytes).map_err(|e| match e {
        exr::error::Error::Io(e) => Error::io(path, e),
        e => Error::Backend(format!("{}: {e}", path.display())),
    })?;
    let mut bytes = bytes.into_inner();
    sort_attributes(&mut bytes);
    fs::write(path, bytes).map_err(|e| Error::io(path, e))
}

/// Puts the attributes of a file into the order of their names: the crate keeps them in a hash map, in another order in
/// every process.
///
/// From byte 8 on, an attribute is its name and type, each ended by a zero, the length of its value in four bytes, and the
/// value; an empty name ends them. Source: "OpenEXR File Layout".
#[cfg(any(test, not(feature = "openexr")))]
fn sort_attributes(file: &mut [u8]) {
    const BEGIN: usize = 8;
    let mut attributes: Vec<&[u8]> = Vec::new();
    let mut rest = &file[BEGIN..];
    while rest.first().is_some_and(|&byte| byte != 0) {
        let mut text = rest.splitn(3, |&byte| byte == 0);
        let (Some(name), Some(kind), Some(value)) = (text.next(), text.next(), text.next()) else { return };
        let Some(&length) = value.first_chunk::<4>() else { return };
        let all = name.len() + kind.len() + 2 + 4 + u32::from_le_bytes(length) as usize;
        let Some((attribute, others)) = rest.split_at_checked(all) else { return };
        attributes.push(attribute);
        rest = others;
    }
    attributes.sort_unstable();
    let sorted = attributes.concat();
    file[BEGIN..BEGIN + sorted.len()].copy_from_slice(&sorted);
}

pub fn read(path: &Path) -> Result<ExrImage> {
    // The crate asserts here and there; a broken file must be an error all the same.
    let caught = catch_unwind(AssertUnwindSafe(|| read_unguarded(path)));
    caught.unwrap_or_else(|_| Err(Error::input(path, "", "the file is damaged")))
}

fn read_unguarded(path: &Path) -> Result<ExrImage> {
    let failed = |e: exr::error::Error| match e {
        exr::error::Error::Io(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => Error::io(path, e),
        e => Error::input(path, "", e.to_string()),
    };
    for header in MetaData::read_from_file(path, false).map_err(failed)?.headers {
        let size = header.layer_size;
        check_size(path, size.width() as u64, size.height() as u64, header.channels.list.len() as u64)?;
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .map_err(failed)?;
    let layer = image.layer_data;
    let channel = |c: AnyChannel<FlatSamples>| {
        let name = String::from_utf8_lossy(c.name.as_slice()).into_owned();
        let half = matches!(c.sample_data, FlatSamples::F16(_));
        let values = match c.sample_data {
            FlatSamples::F16(v) => v.into_iter().map(f16::to_f32).collect(),
            FlatSamples::F32(v) => v,
            FlatSamples::U32(v) => v.into_iter().map(|x| x as f32).collect(),
        };
        ExrChannel { name, half, values }
    };
    let (width, height) = (layer.size.width(), layer.size.height());
    let channels: Vec<ExrChannel> = layer.channel_data.list.into_iter().map(channel).collect();
    // Subsampled channels have fewer values than pixels.
    if let Some(c) = channels.iter().find(|c| c.values.len() != width * height) {
        return Err(Error::input(path, format!("channel {}", c.name), "subsampled channels are not supported"));
    }
    let attributes = texts_and_numbers(layer.attributes);
    Ok(ExrImage { width: width as u32, height: height as u32, channels, attributes })
}

/// The texts that the crate keeps in fields of their own, by their names in the file.
fn text_fields(attributes: &mut LayerAttributes) -> [(&'static str, &mut Option<Text>); 6] {
    [
        ("owner", &mut attributes.owner),
        ("comments", &mut attributes.comments),
        ("capDate", &mut attributes.capture_date),
        ("wrapmodes", &mut attributes.wrap_mode_name),
        ("renderingTransform", &mut attributes.rendering_transform_name),
        ("lookModTransform", &mut attributes.look_modification_transform_name),
    ]
}

/// The numbers that the crate keeps in fields of their own, by their names in the file.
fn number_fields(attributes: &mut LayerAttributes) -> [(&'static str, &mut Option<f32>); 10] {
    [
        ("whiteLuminance", &mut attributes.white_luminance),
        ("xDensity", &mut attributes.horizontal_density),
        ("utcOffset", &mut attributes.utc_offset),
        ("longitude", &mut attributes.longitude),
        ("latitude", &mut attributes.latitude),
        ("altitude", &mut attributes.altitude),
        ("focus", &mut attributes.focus),
        ("expTime", &mut attributes.exposure),
        ("aperture", &mut attributes.aperture),
        ("isoSpeed", &mut attributes.iso_speed),
    ]
}

#[cfg(any(test, not(feature = "openexr")))]
fn insert(attributes: &mut LayerAttributes, name: &str, value: &ExrAttribute) {
    let value = match value {
        ExrAttribute::Text(text) => {
            let text = Text::from_slice_unchecked(text.as_bytes());
            if let Some((_, field)) = text_fields(attributes).into_iter().find(|f| f.0 == name) {
                *field = Some(text);
                return;
            }
            AttributeValue::Text(text)
        }
        ExrAttribute::Float(number) => {
            if let Some((_, field)) = number_fields(attributes).into_iter().find(|f| f.0 == name) {
                *field = Some(*number);
                return;
            }
            AttributeValue::F32(*number)
        }
    };
    attributes.other.insert(Text::from_slice_unchecked(name.as_bytes()), value);
}

fn texts_and_numbers(mut attributes: LayerAttributes) -> Vec<(String, ExrAttribute)> {
    let text = |t: &Text| String::from_utf8_lossy(t.as_slice()).into_owned();
    let mut found = Vec::new();
    for (name, field) in text_fields(&mut attributes) {
        found.extend(field.as_ref().map(|t| (name.to_string(), ExrAttribute::Text(text(t)))));
    }
    for (name, field) in number_fields(&mut attributes) {
        found.extend(field.map(|x| (name.to_string(), ExrAttribute::Float(x))));
    }
    found.extend(attributes.other.iter().filter_map(|(name, value)| match value {
        AttributeValue::Text(t) => Some((text(name), ExrAttribute::Text(text(t)))),
        AttributeValue::F32(x) => Some((text(name), ExrAttribute::Float(*x))),
        _ => None,
    }));
    found.retain(|(name, _)| !super::REQUIRED.contains(&name.as_str()));
    found
}
