//! Arrays as plain bytes: for `#[serde(with = "crate::lxt::raw")]`.
//!
//! One element after the other in the machine's layout, which is little-endian wherever a container can be opened.

use std::{fmt, marker::PhantomData};

use bytemuck::{AnyBitPattern, NoUninit};
use serde::{Deserializer, Serializer, de};

/// Writes the bytes of `array`.
///
/// # Errors
/// Those of the serialiser.
pub fn serialize<T: NoUninit, S: Serializer>(array: &[T], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_bytes(bytemuck::cast_slice(array))
}

/// Reads what [`serialize`] wrote.
///
/// # Errors
/// If the bytes are no whole number of elements.
pub fn deserialize<'de, T: NoUninit + AnyBitPattern, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Vec<T>, D::Error> {
    struct Array<T>(PhantomData<T>);
    impl<T: NoUninit + AnyBitPattern> de::Visitor<'_> for Array<T> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
            write!(f, "elements of {} bytes", size_of::<T>())
        }

        fn visit_bytes<E: de::Error>(self, bytes: &[u8]) -> Result<Vec<T>, E> {
            copied(bytes).ok_or_else(|| E::invalid_length(bytes.len(), &self))
        }
    }
    deserializer.deserialize_bytes(Array(PhantomData))
}

/// The elements that `bytes` are, wherever these lie; `None` if they are no whole number of them.
pub(super) fn copied<T: NoUninit + AnyBitPattern>(bytes: &[u8]) -> Option<Vec<T>> {
    bytes.len().is_multiple_of(size_of::<T>()).then(|| bytemuck::pod_collect_to_vec(bytes))
}
