//! Bytes of a glTF file: buffers, accessors, images; everything is checked before it is read or allocated.

use std::{borrow::Cow, path::Path};

use gltf::{
    accessor::{DataType, Dimensions, sparse::IndexType},
    buffer::View,
};

use super::{
    image::{self, Image},
    path,
};

/// Accessors without a buffer view (all zero, or sparse) may have at most this many elements.
const MOST_ZEROS: usize = 1 << 24;

/// The loaded buffers of a document.
pub(crate) struct Buffers<'a> {
    data: Vec<Cow<'a, [u8]>>,
}

impl<'a> Buffers<'a> {
    /// Reads all buffers; external ones only from inside `folder`.
    pub(crate) fn load(document: &gltf::Document, blob: Option<&'a [u8]>, folder: &Path) -> Result<Self, String> {
        let mut data = Vec::new();
        for buffer in document.buffers() {
            let wrong = |m: String| format!("buffer {}: {m}", buffer.index());
            let bytes = match buffer.source() {
                gltf::buffer::Source::Bin => {
                    Cow::Borrowed(blob.ok_or_else(|| wrong("there is no binary chunk".into()))?)
                }
                gltf::buffer::Source::Uri(uri) => Cow::Owned(resource(uri, folder).map_err(wrong)?),
            };
            if bytes.len() < buffer.length() {
                return Err(wrong(format!("it has {} bytes, {} are promised", bytes.len(), buffer.length())));
            }
            data.push(bytes);
        }
        Ok(Buffers { data })
    }

    fn view(&self, view: &View) -> Result<&[u8], String> {
        let data = &self.data[view.buffer().index()];
        let end = view.offset().checked_add(view.length());
        end.and_then(|end| data.get(view.offset()..end)).ok_or_else(|| {
            format!(
                "bufferView {} (offset {}, length {}) lies beyond its buffer of {} bytes",
                view.index(),
                view.offset(),
                view.length(),
                data.len()
            )
        })
    }

    /// Decodes image `index`; the error is a sentence for a warning.
    pub(crate) fn image(&self, document: &gltf::Document, index: usize, folder: &Path) -> Result<Image, String> {
        let json = &document.as_json().images[index];
        if let Some(uri) = &json.uri {
            let name = if uri.starts_with("data:") { "data URI" } else { uri.as_str() };
            return resource(uri, folder).and_then(|b| image::decode(&b).map_err(|e| format!("\"{name}\": {e}")));
        }
        let view = json.buffer_view.and_then(|v| document.views().nth(v.value()));
        let view = view.ok_or_else(|| format!("image {index} (neither uri nor bufferView)"))?;
        self.view(&view).and_then(image::decode).map_err(|e| format!("image {index} ({e})"))
    }

    /// All elements of an accessor as `N` numbers each; components beyond the accessor's are 0.
    ///
    /// Normalised integers become 0 ..= 1 or -1 ..= 1.
    pub(crate) fn read<const N: usize>(&self, accessor: &gltf::Accessor) -> Result<Vec<[f32; N]>, String> {
        let wrong = |m: String| format!("accessor {}: {m}", accessor.index());
        let components = components(accessor.dimensions()).ok_or_else(|| wrong("matrices hold no vertices".into()))?;
        let kind = accessor.data_type();
        let size = components * component_size(kind);
        let element = |bytes: &[u8]| -> [f32; N] {
            let mut out = [0.0; N];
            for (k, slot) in out.iter_mut().enumerate().take(components) {
                *slot = number(&bytes[k * component_size(kind)..], kind, accessor.normalized());
            }
            out
        };
        let mut out: Vec<[f32; N]> = match accessor.view() {
            Some(view) => {
                self.elements(&view, accessor.offset(), accessor.count(), size).map_err(wrong)?.map(element).collect()
            }
            None if accessor.count() > MOST_ZEROS => {
                return Err(wrong(format!("{} elements without a bufferView", accessor.count())));
            }
            None => vec![[0.0; N]; accessor.count()],
        };
        if let Some(sparse) = accessor.sparse() {
            let (indices, values) = (sparse.indices(), sparse.values());
            let index_size = match indices.index_type() {
                IndexType::U8 => 1,
                IndexType::U16 => 2,
                IndexType::U32 => 4,
            };
            let (index_view, value_view) = (indices.view(), values.view());
            let places = self.elements(&index_view, indices.offset(), sparse.count(), index_size).map_err(wrong)?;
            let values = self.elements(&value_view, values.offset(), sparse.count(), size).map_err(wrong)?;
            for (place, value) in places.zip(values) {
                let place = unsigned(place) as usize;
                *out.get_mut(place).ok_or_else(|| wrong(format!("sparse index {place} does not exist")))? =
                    element(value);
            }
        }
        Ok(out)
    }

    /// All elements of an accessor of indices.
    pub(crate) fn indices(&self, accessor: &gltf::Accessor) -> Result<Vec<u32>, String> {
        let wrong = |m: String| format!("accessor {}: {m}", accessor.index());
        let size = match accessor.data_type() {
            DataType::U8 => 1,
            DataType::U16 => 2,
            DataType::U32 => 4,
            other => return Err(wrong(format!("indices of type {other:?}"))),
        };
        let view = accessor.view().ok_or_else(|| wrong("indices without a bufferView".into()))?;
        if accessor.sparse().is_some() || accessor.dimensions() != Dimensions::Scalar {
            return Err(wrong("indices must be plain numbers".into()));
        }
        Ok(self.elements(&view, accessor.offset(), accessor.count(), size).map_err(wrong)?.map(unsigned).collect())
    }

    /// `count` slices of `size` bytes, all inside the view.
    fn elements(
        &self,
        view: &View,
        offset: usize,
        count: usize,
        size: usize,
    ) -> Result<impl Iterator<Item = &[u8]>, String> {
        let bytes = self.view(view)?;
        let stride = view.stride().unwrap_or(size);
        let needed = match count {
            0 => Some(0),
            _ => (count - 1).checked_mul(stride).and_then(|n| n.checked_add(size)).and_then(|n| n.checked_add(offset)),
        };
        if needed.is_none_or(|n| n > bytes.len()) || stride < size {
            return Err(format!(
                "{count} elements of {size} bytes at offset {offset} do not fit in bufferView {} of {} bytes",
                view.index(),
                bytes.len()
            ));
        }
        Ok((0..count).map(move |i| &bytes[offset + i * stride..][..size]))
    }
}

fn components(dimensions: Dimensions) -> Option<usize> {
    match dimensions {
        Dimensions::Scalar => Some(1),
        Dimensions::Vec2 => Some(2),
        Dimensions::Vec3 => Some(3),
        Dimensions::Vec4 => Some(4),
        _ => None,
    }
}

fn component_size(kind: DataType) -> usize {
    match kind {
        DataType::I8 | DataType::U8 => 1,
        DataType::I16 | DataType::U16 => 2,
        DataType::U32 | DataType::F32 => 4,
    }
}

/// The first component in `bytes`; normalised as glTF 2.0 section 3.11 says.
fn number(bytes: &[u8], kind: DataType, normalised: bool) -> f32 {
    let (value, largest) = match kind {
        DataType::I8 => (f32::from(bytes[0] as i8), 127.0),
        DataType::U8 => (f32::from(bytes[0]), 255.0),
        DataType::I16 => (f32::from(i16::from_le_bytes([bytes[0], bytes[1]])), 32767.0),
        DataType::U16 => (f32::from(u16::from_le_bytes([bytes[0], bytes[1]])), 65535.0),
        DataType::U32 => return unsigned(&bytes[..4]) as f32,
        DataType::F32 => return f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
    };
    if normalised { (value / largest).max(-1.0) } else { value }
}

/// Little-endian, up to 4 bytes.
fn unsigned(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |n, b| n << 8 | u32::from(*b))
}

/// The bytes that a URI of a file in `folder` stands for.
fn resource(uri: &str, folder: &Path) -> Result<Vec<u8>, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, text) = data.split_once(";base64,").ok_or("its data URI is not base64")?;
        return base64(text).ok_or_else(|| "its data URI is not base64".to_string());
    }
    if uri.contains("://") {
        return Err(format!("\"{uri}\" is not a file"));
    }
    let path = percent_decode(uri).ok_or_else(|| format!("\"{uri}\" is not percent-encoded UTF-8"))?;
    let path = path::inside(folder, &path).map_err(|cause| format!("\"{uri}\" cannot be read: {cause}"))?;
    std::fs::read(path).map_err(|e| format!("\"{uri}\" cannot be read: {e}"))
}

/// RFC 4648 section 4; padding may be absent.
fn base64(text: &str) -> Option<Vec<u8>> {
    let text = text.trim_end_matches('=').as_bytes();
    let mut out = Vec::with_capacity(text.len() / 4 * 3 + 2);
    for group in text.chunks(4) {
        let mut bits = 0_u32;
        for &c in group {
            let six = match c {
                b'A'..=b'Z' => c - b'A',
                b'a'..=b'z' => c - b'a' + 26,
                b'0'..=b'9' => c - b'0' + 52,
                b'+' => 62,
                b'/' => 63,
                _ => return None,
            };
            bits = bits << 6 | u32::from(six);
        }
        // One letter alone holds no whole byte.
        let bytes = match group.len() {
            4 => 3,
            3 => 2,
            2 => 1,
            _ => return None,
        };
        let bits = bits << (6 * (4 - group.len()));
        out.extend_from_slice(&bits.to_be_bytes()[1..1 + bytes]);
    }
    Some(out)
}

/// RFC 3986 section 2.1.
fn percent_decode(text: &str) -> Option<String> {
    let bytes = text.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut i = 0;
    while i < bytes.len() {
        if bytes[i] == b'%' {
            let hex = std::str::from_utf8(bytes.get(i + 1..i + 3)?).ok()?;
            out.push(u8::from_str_radix(hex, 16).ok()?);
            i += 3;
        } else {
            out.push(bytes[i]);
            i += 1;
        }
    }
    String::from_utf8(out).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_reads_the_vectors_of_rfc_4648() {
        for (text, bytes) in
            [("", ""), ("Zg==", "f"), ("Zm8=", "fo"), ("Zm9v", "foo"), ("Zm9vYg", "foob"), ("Zm9vYmFy", "foobar")]
        {
            assert_eq!(base64(text).unwrap(), bytes.as_bytes());
        }
        assert!(base64("@@@@").is_none());
        assert!(base64("Zm9vY").is_none());
    }

    #[test]
    fn percent_signs_are_decoded_before_the_path_is_checked() {
        assert_eq!(percent_decode("a%20b%2E.bin").unwrap(), "a b..bin");
        assert!(percent_decode("%zz").is_none() && percent_decode("%2").is_none() && percent_decode("%ff").is_none());
        let error = resource("%2e%2e/secret", Path::new("/tmp")).unwrap_err();
        assert!(error.contains("outside"), "{error}");
    }

    #[test]
    fn normalised_integers_span_their_range() {
        assert_eq!(number(&[255], DataType::U8, true), 1.0);
        assert_eq!(number(&[0x80], DataType::I8, true), -1.0);
        assert_eq!(number(&[0xff, 0xff], DataType::U16, true), 1.0);
        assert_eq!(number(&[2, 1], DataType::U16, false), 258.0);
    }
}
