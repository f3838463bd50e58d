//! Assembles an upload in memory, a weights image or the description of a bench, and validates it before it is used.
//!
//! A chunk whose answer was lost may be sent again. The caller decides whether an upload is allowed (not while
//! ventilating).

use crate::checksum::crc32;
use crate::link::refusal::Refusal;
use crate::weights::trust::Trust;
use crate::weights::{IMAGE_BYTES, ImageProblem, decode_trusted};

/// What is uploaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Announced {
    length: usize,
    id: u32,
}

/// An upload in progress, or none.
#[derive(Clone, Debug)]
pub struct Upload {
    bytes: [u8; IMAGE_BYTES],
    received: usize,
    announced: Option<Announced>,
}

impl Upload {
    /// No upload.
    pub const fn new() -> Self {
        Self { bytes: [0; IMAGE_BYTES], received: 0, announced: None }
    }

    /// Begins an upload of this length and id; returns the next expected offset, which is not zero if an interrupted upload of the same
    /// content continues. Any other unfinished upload is discarded.
    ///
    /// # Errors
    /// [`Refusal::WrongLength`].
    pub fn begin(&mut self, length: u32, id: u32) -> Result<u32, Refusal> {
        let announced = Announced { length: length as usize, id };
        if announced.length > IMAGE_BYTES {
            return Err(Refusal::WrongLength);
        }
        if self.announced != Some(announced) {
            (self.received, self.announced) = (0, Some(announced));
        }
        Ok(self.received as u32)
    }

    /// Adds a chunk; returns the next expected offset.
    ///
    /// # Errors
    /// [`Refusal::NoUpload`]; [`Refusal::WrongOffset`] unless the chunk follows the last one or repeats received
    /// bytes.
    pub fn chunk(&mut self, offset: u32, chunk: &[u8]) -> Result<u32, Refusal> {
        let Announced { length, .. } = self.announced.ok_or(Refusal::NoUpload)?;
        let expected = self.received as u32;
        let refusal = Refusal::WrongOffset { expected };
        let (start, end) = (offset as usize, (offset as usize).saturating_add(chunk.len()));
        let repeated = end <= self.received;
        let place = self.bytes[..length].get_mut(start..end).ok_or(refusal)?;
        if repeated && *place == *chunk {
            return Ok(expected);
        }
        if start != self.received {
            return Err(refusal);
        }
        place.copy_from_slice(chunk);
        self.received = end;
        debug_assert!(self.received <= IMAGE_BYTES);
        Ok(end as u32)
    }

    /// What was announced, if all of it has arrived.
    fn complete(&self) -> Result<Announced, Refusal> {
        let announced = self.announced.ok_or(Refusal::NoUpload)?;
        if self.received < announced.length {
            let expected = self.received as u32;
            return Err(Refusal::WrongOffset { expected });
        }
        Ok(announced)
    }

    /// The whole description of a bench; its id is the CRC-32 of its bytes. It stays, so that a host whose answer was lost may ask again.
    ///
    /// # Errors
    /// [`Refusal::NoUpload`], [`Refusal::WrongOffset`] if bytes are missing, [`Refusal::OtherImage`] if the id is another.
    pub fn description(&self) -> Result<&[u8], Refusal> {
        let Announced { length, id } = self.complete()?;
        let bytes = &self.bytes[..length];
        if crc32(bytes) == id { Ok(bytes) } else { Err(Refusal::OtherImage) }
    }

    /// Validates the whole image, whose bytes are then in [`Upload::bytes`]; returns its id.
    ///
    /// # Errors
    /// [`Refusal::NoUpload`], [`Refusal::WrongOffset`] if bytes are missing, [`Refusal::WrongLength`], [`Refusal::BadImage`],
    /// [`Refusal::Unsigned`], [`Refusal::WrongSignature`] or [`Refusal::OtherPlant`] if the device does not trust it,
    /// [`Refusal::OtherImage`] if its id is not the announced one.
    pub fn commit(&mut self, trust: &Trust) -> Result<u32, Refusal> {
        let Announced { length, id } = self.complete()?;
        self.announced = None;
        if length != IMAGE_BYTES {
            return Err(Refusal::WrongLength);
        }
        let found =
            decode_trusted(&self.bytes, trust, |image| image.id).map_err(|error| match error.into() {
                ImageProblem::Unsigned => Refusal::Unsigned,
                ImageProblem::Signature => Refusal::WrongSignature,
                ImageProblem::Plant => Refusal::OtherPlant,
                problem => Refusal::BadImage(problem),
            })?;
        if found != id {
            return Err(Refusal::OtherImage);
        }
        Ok(id)
    }

    /// The bytes that [`Upload::commit`] validated.
    pub fn bytes(&self) -> &[u8; IMAGE_BYTES] {
        &self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::features::FeatureSpec;
    use crate::control::network::Network;
    use crate::control::pid::PidGains;
    use crate::control::residual::{Residual, ResidualSpec};
    use crate::link::messages::CHUNK_BYTES;
    use crate::weights::{Identity, decode, encode};
    use proptest::prelude::*;

    const DEVELOPMENT: &Trust = &Trust::Development;

    fn image() -> ([u8; IMAGE_BYTES], u32) {
        let spec = ResidualSpec {
            period_us: 1000,
            gains: PidGains::default(),
            lambda: 1.0,
            authority: 50.0,
            features: FeatureSpec::default(),
        };
        let mut bytes = [0; IMAGE_BYTES];
        let residual = Residual::new(spec, Network::zero()).unwrap();
        encode(&residual, &Identity::default(), &mut bytes).unwrap();
        (bytes, decode(&bytes).unwrap().id)
    }

    fn send(upload: &mut Upload, bytes: &[u8]) {
        for (index, chunk) in bytes.chunks(CHUNK_BYTES).enumerate() {
            let offset = (index * CHUNK_BYTES) as u32;
            assert_eq!(upload.chunk(offset, chunk), Ok(offset + chunk.len() as u32));
            assert_eq!(upload.chunk(offset, chunk), Ok(offset + chunk.len() as u32), "repeated");
        }
    }

    #[test]
    fn an_image_arrives_in_chunks_some_of_them_twice() {
        let ((bytes, id), mut upload) = (image(), Upload::new());
        assert_eq!(upload.begin(IMAGE_BYTES as u32, id), Ok(0));
        send(&mut upload, &bytes);
        assert_eq!(upload.commit(DEVELOPMENT), Ok(decode(&bytes).unwrap().id));
        assert_eq!(*upload.bytes(), bytes);
        assert_eq!(upload.commit(DEVELOPMENT), Err(Refusal::NoUpload));
    }

    #[test]
    fn an_upload_that_was_broken_off_goes_on_where_it_was_and_another_image_starts_over() {
        let ((bytes, id), mut upload) = (image(), Upload::new());
        upload.begin(IMAGE_BYTES as u32, id).unwrap();
        upload.chunk(0, &bytes[..300]).unwrap();
        assert_eq!(upload.begin(IMAGE_BYTES as u32, id), Ok(300));
        assert_eq!(upload.begin(IMAGE_BYTES as u32, id ^ 1), Ok(0));
    }

    #[test]
    fn order_and_completeness_are_demanded() {
        let ((bytes, id), mut upload) = (image(), Upload::new());
        let expected = 0;
        assert_eq!(upload.chunk(0, &bytes[..10]), Err(Refusal::NoUpload));
        assert_eq!(upload.begin(IMAGE_BYTES as u32 + 1, id), Err(Refusal::WrongLength));
        upload.begin(IMAGE_BYTES as u32, id).unwrap();
        assert_eq!(upload.chunk(128, &bytes[..10]), Err(Refusal::WrongOffset { expected }));
        assert_eq!(upload.commit(DEVELOPMENT), Err(Refusal::WrongOffset { expected }));
        upload.chunk(0, &bytes[..10]).unwrap();
        let expected = 10;
        assert_eq!(upload.chunk(0, &[9; 10]), Err(Refusal::WrongOffset { expected }));
    }

    #[test]
    fn a_description_is_as_long_as_it_was_announced_and_has_its_checksum() {
        let (description, mut upload) = ([7_u8, 8, 9], Upload::new());
        let id = crc32(&description);
        let begin = |upload: &mut Upload, length, id| upload.begin(length, id).unwrap();
        begin(&mut upload, 3, id);
        assert_eq!(upload.chunk(0, &[7, 8, 9, 10]), Err(Refusal::WrongOffset { expected: 0 }));
        upload.chunk(0, &description[..2]).unwrap();
        assert_eq!(upload.description(), Err(Refusal::WrongOffset { expected: 2 }));
        assert_eq!(begin(&mut upload, 4, id), 0, "another length is another upload");
        begin(&mut upload, 3, id);
        upload.chunk(0, &description).unwrap();
        assert_eq!(upload.commit(DEVELOPMENT), Err(Refusal::WrongLength));
        begin(&mut upload, 3, id);
        upload.chunk(0, &description).unwrap();
        assert_eq!(upload.description(), Ok(&description[..]));
        assert_eq!(upload.description(), Ok(&description[..]), "asked again");
        begin(&mut upload, 3, id ^ 1);
        upload.chunk(0, &description).unwrap();
        assert_eq!(upload.description(), Err(Refusal::OtherImage));
    }

    #[test]
    fn a_damaged_image_and_another_image_are_refused() {
        let ((mut bytes, id), mut upload) = (image(), Upload::new());
        upload.begin(IMAGE_BYTES as u32, id ^ 1).unwrap();
        send(&mut upload, &bytes);
        assert_eq!(upload.commit(DEVELOPMENT), Err(Refusal::OtherImage));
        bytes[1000] ^= 4;
        upload.begin(IMAGE_BYTES as u32, id).unwrap();
        send(&mut upload, &bytes);
        assert_eq!(upload.commit(DEVELOPMENT), Err(Refusal::BadImage(ImageProblem::Checksum)));
    }

    proptest! {
        #[test]
        fn no_order_of_chunks_panics_or_invents_bytes(chunks in prop::collection::vec((any::<u32>(), 0u32..300, 0usize..200), 0..50)) {
            let mut upload = Upload::new();
            upload.begin(IMAGE_BYTES as u32, 0).unwrap();
            let mut received = 0;
            for (far, near, length) in chunks {
                let offset = if near < 200 { near } else { far };
                if let Ok(next) = upload.chunk(offset, &[7; 200][..length]) {
                    prop_assert!(next >= received && next <= received + length as u32);
                    received = next;
                }
            }
        }
    }
}
