//! Packs and validates the image. The checks have a fixed order, so that the error names the first problem: length,
//! magic, format version, checksum, signature, architecture, sizes, parameters, specification, golden values.

use serde::{Deserialize, Serialize};

use super::exercise::{Golden, golden};
use super::trust::Trust;
use super::{
    ARCHITECTURE, FORMAT_VERSION, HEADER_BYTES, IMAGE_BYTES, Identity, Image, MAGIC, PARAMETER_BYTES,
    SIGNATURE_BYTES, SIGNED_BYTES, WeightsError,
};
use crate::checksum::{CHECKSUM_BYTES, crc32};
use crate::control::features::FeatureSpec;
use crate::control::network::{Network, WEIGHT_MAX};
use crate::control::pid::PidGains;
use crate::control::residual::{Residual, ResidualSpec};

/// The part before the parameters. Postcard writes floats and bytes at their full length, without padding.
#[derive(Serialize, Deserialize)]
struct Header {
    magic: [u8; 4],
    #[serde(with = "postcard::fixint::le")]
    version: u16,
    #[serde(with = "postcard::fixint::le")]
    architecture: u16,
    /// Sizes of the layers, u16 little endian.
    shape: [[u8; 2]; 4],
    #[serde(with = "postcard::fixint::le")]
    period_us: u32,
    gains: PidGains,
    lambda: f32,
    authority: f32,
    features: FeatureSpec,
    identity: Identity,
    golden: Golden,
    #[serde(with = "postcard::fixint::le")]
    parameter_bytes: u32,
    #[serde(with = "postcard::fixint::le")]
    image_version: u32,
}

/// Packs a learned controller, unsigned and with version 0; returns the number of bytes written, [`IMAGE_BYTES`].
///
/// # Errors
/// [`WeightsError::Length`] if `out` is too short.
pub fn encode(residual: &Residual, identity: &Identity, out: &mut [u8]) -> Result<usize, WeightsError> {
    let too_short = WeightsError::Length { have: out.len(), need: IMAGE_BYTES };
    let image = out.get_mut(..IMAGE_BYTES).ok_or(too_short)?;
    let ResidualSpec { period_us, gains, lambda, authority, features } = *residual.spec();
    let header = Header {
        magic: MAGIC,
        version: FORMAT_VERSION,
        architecture: ARCHITECTURE,
        shape: Network::SHAPE.map(|size| (size as u16).to_le_bytes()),
        period_us,
        gains,
        lambda,
        authority,
        features,
        identity: *identity,
        golden: golden(residual),
        parameter_bytes: PARAMETER_BYTES as u32,
        image_version: 0,
    };
    postcard::to_slice(&header, image).map_err(|_| too_short)?;
    let (places, _) = image[HEADER_BYTES..].as_chunks_mut();
    for (place, parameter) in places.iter_mut().zip(residual.network().parameters()) {
        *place = parameter.to_le_bytes();
    }
    image[SIGNED_BYTES..].fill(0);
    let checksum = crc32(&image[..IMAGE_BYTES - CHECKSUM_BYTES]);
    image[IMAGE_BYTES - CHECKSUM_BYTES..].copy_from_slice(&checksum.to_le_bytes());
    Ok(IMAGE_BYTES)
}

/// Validates an image that a device is to run, one that its [`Trust`] allows, and returns what `take` makes of it. The image itself is
/// not returned, because each move of it would take kilobytes of the chip's stack.
///
/// # Errors
/// As [`decode`]; a wrong signature is reported before the content is looked at, and after damage.
pub fn decode_trusted<T>(
    bytes: &[u8],
    trust: &Trust,
    take: impl FnMut(&Image) -> T,
) -> Result<T, WeightsError> {
    enclosed(bytes)?;
    trust.verify(bytes)?;
    built(bytes, take)
}

/// Validates an image and builds its controller. Bytes after the image are ignored.
///
/// # Errors
/// The first problem, in the order at the top of this file; the signature is not verified ([`decode_trusted`]).
pub fn decode(bytes: &[u8]) -> Result<Image, WeightsError> {
    built(bytes, Image::clone)
}

/// What `take` makes of a valid image.
fn built<T>(bytes: &[u8], mut take: impl FnMut(&Image) -> T) -> Result<T, WeightsError> {
    // Until it is taken.
    let mut taken = Err(WeightsError::Golden);
    build(bytes, &mut |image| taken = Ok(take(image)))?;
    taken
}

/// Builds the controller of an image, checks its golden values, and lends it to `take`. Not inlined, so that it is on the stack only
/// meanwhile.
#[inline(never)]
fn build(bytes: &[u8], take: &mut dyn FnMut(&Image)) -> Result<(), WeightsError> {
    let (header, parameters, id) = enclosed(bytes)?;
    let Header { architecture, period_us, gains, lambda, authority, features, .. } = header;
    if architecture != ARCHITECTURE {
        return Err(WeightsError::Architecture(architecture));
    }
    let shape = header.shape.map(u16::from_le_bytes);
    if shape.map(usize::from) != Network::SHAPE || parameters.len() != PARAMETER_BYTES {
        return Err(WeightsError::Shape(shape));
    }
    let parameters = parameters.as_chunks().0;
    let bounded = |parameter: &[u8; 4]| f32::from_le_bytes(*parameter).abs() <= WEIGHT_MAX;
    if let Some(index) = parameters.iter().position(|parameter| !bounded(parameter)) {
        return Err(WeightsError::Weight(index));
    }
    let spec = ResidualSpec { period_us, gains, lambda, authority, features };
    let parts = spec.parts()?;
    let mut image = Image {
        residual: Residual::zero(spec, parts),
        identity: header.identity,
        version: header.image_version,
        golden: header.golden,
        id,
    };
    for (parameter, bytes) in image.residual.parameters_mut().zip(parameters) {
        *parameter = f32::from_le_bytes(*bytes);
    }
    if golden(&image.residual) != image.golden {
        return Err(WeightsError::Golden);
    }
    take(&image);
    Ok(())
}

/// Header, parameters and id of a complete and undamaged image of this format. The header gives the length, so that a
/// valid image of another architecture is not mistaken for a damaged one.
fn enclosed(bytes: &[u8]) -> Result<(Header, &[u8], u32), WeightsError> {
    let short = |need| WeightsError::Length { have: bytes.len(), need };
    let (header, _): (Header, _) = postcard::take_from_bytes(bytes).map_err(|_| short(IMAGE_BYTES))?;
    if header.magic != MAGIC {
        return Err(WeightsError::Magic);
    }
    if header.version != FORMAT_VERSION {
        return Err(WeightsError::Version(header.version));
    }
    let need =
        (HEADER_BYTES + SIGNATURE_BYTES + CHECKSUM_BYTES).saturating_add(header.parameter_bytes as usize);
    let image = bytes.get(..need).ok_or(short(need))?;
    let (covered, checksum) = image.split_last_chunk().ok_or(short(need))?;
    let id = u32::from_le_bytes(*checksum);
    if crc32(covered) != id {
        return Err(WeightsError::Checksum);
    }
    Ok((header, &covered[HEADER_BYTES..need - SIGNATURE_BYTES - CHECKSUM_BYTES], id))
}

#[cfg(test)]
mod tests;
