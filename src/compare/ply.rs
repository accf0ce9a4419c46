//! PLY files: the vertices of binary little-endian ones, as `luxel bake` writes them.

use std::{fs, path::Path};

use super::table::{Table, of_columns};
use crate::{Error, Result};

/// Reads the vertices of `path`; faces and what follows them are left alone.
pub fn read(path: &Path) -> Result<Table> {
    let bytes = fs::read(path).map_err(|e| Error::io(path, e))?;
    parse(path, &bytes)
}

/// A number of a vertex.
struct Property {
    name: String,
    kind: Kind,
    offset: usize,
}

#[derive(Clone, Copy)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn new(name: &str) -> Option<Kind> {
        Some(match name {
            "char" | "int8" => Kind::I8,
            "uchar" | "uint8" => Kind::U8,
            "short" | "int16" => Kind::I16,
            "ushort" | "uint16" => Kind::U16,
            "int" | "int32" => Kind::I32,
            "uint" | "uint32" => Kind::U32,
            "float" | "float32" => Kind::F32,
            "double" | "float64" => Kind::F64,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Kind::I8 | Kind::U8 => 1,
            Kind::I16 | Kind::U16 => 2,
            Kind::I32 | Kind::U32 | Kind::F32 => 4,
            Kind::F64 => 8,
        }
    }

    /// The number that `b` (of the right length) starts with.
    fn value(self, b: &[u8]) -> f64 {
        match self {
            Kind::I8 => b[0] as i8 as f64,
            Kind::U8 => b[0] as f64,
            Kind::I16 => i16::from_le_bytes([b[0], b[1]]) as f64,
            Kind::U16 => u16::from_le_bytes([b[0], b[1]]) as f64,
            Kind::I32 => i32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f64,
            Kind::U32 => u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f64,
            Kind::F32 => f32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f64,
            Kind::F64 => f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]),
        }
    }
}

fn parse(path: &Path, bytes: &[u8]) -> Result<Table> {
    let wrong = |message: String| Error::input(path, "header", message);
    const END: &[u8] = b"end_header\n";
    let end = bytes.windows(END.len()).position(|w| w == END);
    let end = end.filter(|_| bytes.starts_with(b"ply")).ok_or_else(|| wrong("this is not a PLY file".into()))?;
    let header = String::from_utf8_lossy(&bytes[..end]);
    let (mut properties, mut count, mut elements, mut stride) = (Vec::new(), 0, 0, 0_usize);
    for line in header.lines() {
        match line.split_whitespace().collect::<Vec<_>>().as_slice() {
            ["format", format, ..] if *format != "binary_little_endian" => {
                return Err(wrong(format!("format {format} is not read; binary_little_endian was expected")));
            }
            ["element", "vertex", n] if elements == 0 => {
                count = n.parse().map_err(|_| wrong(format!("{n:?} is not a number of vertices")))?;
                elements = 1;
            }
            ["element", ..] if elements == 0 => return Err(wrong("vertices were expected first".into())),
            ["element", ..] => elements += 1,
            ["property", kind, name] if elements == 1 => {
                let kind = Kind::new(kind).ok_or_else(|| wrong(format!("property {name}: unknown type {kind}")))?;
                properties.push(Property { name: name.to_string(), kind, offset: stride });
                stride += kind.bytes();
            }
            ["property", "list", ..] if elements == 1 => return Err(wrong("a vertex has a list".into())),
            _ => (),
        }
    }
    let data = &bytes[end + END.len()..];
    if count == 0 {
        return Err(wrong("there are no vertices".into()));
    }
    if stride.checked_mul(count).is_none_or(|needed| needed > data.len()) {
        return Err(wrong(format!("{count} vertices of {stride} bytes do not fit the {} that follow", data.len())));
    }
    let names: Vec<String> = properties.iter().map(|p| p.name.clone()).collect();
    of_columns(path, &names, |k| {
        let p = &properties[k];
        data.chunks_exact(stride).take(count).map(|vertex| p.kind.value(&vertex[p.offset..])).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> std::result::Result<Table, String> {
        parse(Path::new("a.ply"), bytes).map_err(|e| e.to_string())
    }

    const HEADER: &str = "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty double x\nproperty uchar y\n\
                          property short z\nproperty float direct_r\nproperty float direct_g\nproperty float direct_b\n\
                          element face 1\nproperty list uchar uint vertex_indices\nend_header\n";

    #[test]
    fn vertices_of_all_types_are_read() {
        let mut file = HEADER.as_bytes().to_vec();
        for k in [1_u8, 2] {
            file.extend((k as f64 + 0.5).to_le_bytes());
            file.push(200);
            file.extend((-3_i16).to_le_bytes());
            [k as f32, 0.25, 8.0].iter().for_each(|x| file.extend(x.to_le_bytes()));
        }
        file.extend([3, 0, 0, 0]);
        let table = read(&file).unwrap();
        assert_eq!(table.positions, Some(vec![[1.5, 200.0, -3.0], [2.5, 200.0, -3.0]]));
        assert_eq!(table.layers[0].bands, [vec![1.0, 2.0], vec![0.25; 2], vec![8.0; 2]]);
        assert_eq!(table.layers.len(), 1);
        let cut = &file[..HEADER.len() + 40];
        assert_eq!(read(cut).unwrap_err(), "a.ply: header: 2 vertices of 23 bytes do not fit the 40 that follow");
    }

    #[test]
    fn other_files_are_refused() {
        assert_eq!(read(b"solid").unwrap_err(), "a.ply: header: this is not a PLY file");
        assert_eq!(
            read(b"ply\nformat ascii 1.0\nend_header\n").unwrap_err(),
            "a.ply: header: format ascii is not read; binary_little_endian was expected"
        );
        let huge = HEADER.replace("vertex 2", "vertex 18446744073709551615");
        assert!(read(huge.as_bytes()).unwrap_err().contains("do not fit"));
        assert!(read(b"ply\nformat binary_little_endian 1.0\nend_header\n").unwrap_err().contains("no vertices"));
    }
}
