//! Reading and writing little-endian values one after the other, without panics.

use super::WeightsError;

/// Writes values into a slice; what does not fit is an error.
pub(super) struct Writer<'a> {
    out: &'a mut [u8],
    at: usize,
}

impl<'a> Writer<'a> {
    pub(super) fn new(out: &'a mut [u8]) -> Self {
        Self { out, at: 0 }
    }

    pub(super) fn bytes(&mut self, bytes: &[u8]) -> Result<(), WeightsError> {
        let (have, need) = (self.out.len(), self.at + bytes.len());
        let place = self.out.get_mut(self.at..need);
        place.ok_or(WeightsError::Length { have, need })?.copy_from_slice(bytes);
        self.at = need;
        Ok(())
    }

    pub(super) fn u16(&mut self, value: u16) -> Result<(), WeightsError> {
        self.bytes(&value.to_le_bytes())
    }

    pub(super) fn u32(&mut self, value: u32) -> Result<(), WeightsError> {
        self.bytes(&value.to_le_bytes())
    }

    pub(super) fn reals<'v>(
        &mut self,
        values: impl IntoIterator<Item = &'v f32>,
    ) -> Result<(), WeightsError> {
        values.into_iter().try_for_each(|value| self.bytes(&value.to_le_bytes()))
    }

    /// The bytes written so far.
    pub(super) fn written(&self) -> &[u8] {
        self.out.get(..self.at).unwrap_or(&[])
    }
}

/// Reads values from a slice.
pub(super) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    pub(super) fn array<const N: usize>(&mut self) -> Result<[u8; N], WeightsError> {
        let rest = self.bytes.get(self.at..).unwrap_or(&[]);
        let (have, need) = (self.bytes.len(), self.at + N);
        let array = rest.first_chunk().ok_or(WeightsError::Length { have, need })?;
        self.at = need;
        Ok(*array)
    }

    pub(super) fn u16(&mut self) -> Result<u16, WeightsError> {
        self.array().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, WeightsError> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn real(&mut self) -> Result<f32, WeightsError> {
        self.array().map(f32::from_le_bytes)
    }

    pub(super) fn reals<const N: usize>(&mut self) -> Result<[f32; N], WeightsError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.real()?;
        }
        Ok(values)
    }
}
