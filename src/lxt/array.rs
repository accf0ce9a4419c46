//! Arrays that may lie in a mapped file.

use std::{
    fmt,
    ops::{Deref, DerefMut},
};

use bytemuck::Pod;
use bytes::Bytes;
use rayon::prelude::*;

use super::raw;

/// Plain values one after the other: in memory of their own, or where a file that is mapped has them. These are copied
/// when somebody wants to change them.
#[derive(Clone)]
pub struct Array<T> {
    /// In memory of their own, unless they are mapped.
    own: Vec<T>,
    /// A whole number of values, at an address that suits them.
    mapped: Option<Bytes>,
}

impl<T: Pod> Array<T> {
    /// The values that `bytes` are, in the machine's layout; `None` if they are no whole number of values.
    pub fn of_bytes(bytes: Bytes) -> Option<Array<T>> {
        match bytemuck::try_cast_slice::<u8, T>(&bytes) {
            Ok(_) => Some(Array { own: Vec::new(), mapped: Some(bytes) }),
            Err(_) => raw::copied(&bytes).map(Into::into),
        }
    }

    /// The list, in memory of its own from now on.
    pub fn own(&mut self) -> &mut Vec<T> {
        if self.mapped.is_some() {
            *self = self.to_vec().into();
        }
        &mut self.own
    }
}

impl<T: Pod> Deref for Array<T> {
    type Target = [T];

    #[inline(always)]
    fn deref(&self) -> &[T] {
        self.mapped.as_ref().map_or(&self.own[..], |bytes| bytemuck::cast_slice(bytes))
    }
}

impl<T: Pod> DerefMut for Array<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        self.own()
    }
}

impl<T> Default for Array<T> {
    fn default() -> Array<T> {
        Vec::new().into()
    }
}

impl<T> From<Vec<T>> for Array<T> {
    fn from(list: Vec<T>) -> Array<T> {
        Array { own: list, mapped: None }
    }
}

impl<T> FromIterator<T> for Array<T> {
    fn from_iter<I: IntoIterator<Item = T>>(values: I) -> Array<T> {
        Vec::from_iter(values).into()
    }
}

impl<T: Send> FromParallelIterator<T> for Array<T> {
    fn from_par_iter<I: IntoParallelIterator<Item = T>>(values: I) -> Array<T> {
        Vec::from_par_iter(values).into()
    }
}

impl<'a, T: Pod> IntoIterator for &'a Array<T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl<T: Pod + PartialEq> PartialEq for Array<T> {
    fn eq(&self, other: &Array<T>) -> bool {
        **self == **other
    }
}

impl<T: Pod + fmt::Debug> fmt::Debug for Array<T> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        (**self).fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_the_same_array_wherever_they_lie_and_are_copied_when_it_changes() {
        let values = [[1_u32, 2], [3, 4], [5, 6]];
        let mut bytes = vec![0; 8];
        bytes.extend_from_slice(bytemuck::cast_slice(&values));
        bytes.extend([0; 8]);
        let bytes = Bytes::from(bytes);
        // One of these two at least is at an odd address.
        let mut shifted = vec![0; 9];
        shifted.extend_from_slice(&bytes[8..32]);
        let shifted = Bytes::from(shifted);
        for place in [bytes.slice(8..32), shifted.slice(9..)] {
            let mut array = Array::<[u32; 2]>::of_bytes(place.clone()).unwrap();
            assert_eq!(*array, values);
            let before = array.clone();
            array[1] = [7, 7];
            array.own().push([8, 8]);
            assert_eq!(*array, [[1, 2], [7, 7], [5, 6], [8, 8]]);
            assert_eq!((&*before, &place[..]), (&values[..], bytemuck::cast_slice(&values)));
        }
        assert!(Array::<[u32; 2]>::of_bytes(bytes.slice(8..31)).is_none());
    }
}
