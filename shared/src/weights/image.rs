//! Packing and validating the image. Validation goes from the outside in, so that each error names the first
//! thing that is wrong: length, magic, version, checksum, architecture, sizes, parameters, specification,
//! golden values.

use super::bytes::{Reader, Writer};
use super::exercise::{Golden, golden};
use super::{
    ARCHITECTURE, FORMAT_VERSION, HEADER_BYTES, IMAGE_BYTES, Identity, Image, MAGIC, PARAMETER_BYTES,
    WeightsError,
};
use crate::checksum::{CHECKSUM_BYTES, crc32, verified};
use crate::control::features::FeatureSpec;
use crate::control::network::{Network, WEIGHT_MAX};
use crate::control::pid::PidGains;
use crate::control::residual::{Residual, ResidualSpec};

/// Packs a learned controller; gives the bytes written, [`IMAGE_BYTES`].
///
/// # Errors
/// [`WeightsError::Length`] if `out` is too short.
pub fn encode(residual: &Residual, identity: &Identity, out: &mut [u8]) -> Result<usize, WeightsError> {
    if out.len() < IMAGE_BYTES {
        return Err(WeightsError::Length { have: out.len(), need: IMAGE_BYTES });
    }
    let mut writer = Writer::new(out);
    writer.bytes(&MAGIC)?;
    writer.u16(FORMAT_VERSION)?;
    writer.u16(ARCHITECTURE)?;
    for size in Network::SHAPE {
        writer.u16(size as u16)?;
    }
    write_spec(&mut writer, residual.spec())?;
    writer.bytes(&identity.training)?;
    writer.bytes(&identity.plant)?;
    let golden = golden(residual);
    writer.u32(golden.last)?;
    writer.u32(golden.all)?;
    writer.u32(PARAMETER_BYTES as u32)?;
    writer.reals(residual.network().parameters())?;
    let checksum = crc32(writer.written());
    writer.u32(checksum)?;
    Ok(IMAGE_BYTES)
}

fn write_spec(writer: &mut Writer, spec: &ResidualSpec) -> Result<(), WeightsError> {
    let ResidualSpec { period_us, gains, lambda, authority, features } = spec;
    writer.u32(*period_us)?;
    writer.reals(&[gains.p, gains.i, gains.d, *lambda, *authority])?;
    writer.bytes(&features.error_taps)?;
    writer.bytes(&features.command_taps)?;
    writer.reals(&features.error_averages)?;
    writer.reals(&features.command_averages)?;
    writer.reals(&features.times)
}

/// Validates an image and builds its controller. Bytes after the image are ignored.
///
/// # Errors
/// The first thing that is wrong, in the order of [`WeightsError`]'s variants.
pub fn decode(bytes: &[u8]) -> Result<Image, WeightsError> {
    let mut reader = Reader::new(enclosed(bytes)?);
    reader.array::<6>()?;
    let architecture = reader.u16()?;
    if architecture != ARCHITECTURE {
        return Err(WeightsError::Architecture(architecture));
    }
    let shape = [reader.u16()?, reader.u16()?, reader.u16()?, reader.u16()?];
    if shape.map(usize::from) != Network::SHAPE {
        return Err(WeightsError::Shape(shape));
    }
    let spec = read_spec(&mut reader)?;
    let identity = Identity { training: reader.array()?, plant: reader.array()? };
    let promised = Golden { last: reader.u32()?, all: reader.u32()? };
    if reader.u32()? as usize != PARAMETER_BYTES {
        return Err(WeightsError::Shape(shape));
    }
    let network = read_network(&mut reader)?;
    let id = reader.u32()?;
    let residual = Residual::new(spec, network)?;
    if golden(&residual) != promised {
        return Err(WeightsError::Golden);
    }
    Ok(Image { residual, identity, golden: promised, id })
}

/// The image without what follows it: long enough, of this format, undamaged. Its length is its own, so that a
/// sound image of another architecture is told from a damaged one.
fn enclosed(bytes: &[u8]) -> Result<&[u8], WeightsError> {
    let short = |need| WeightsError::Length { have: bytes.len(), need };
    if bytes.len() < HEADER_BYTES {
        return Err(short(IMAGE_BYTES));
    }
    let mut reader = Reader::new(bytes);
    if reader.array()? != MAGIC {
        return Err(WeightsError::Magic);
    }
    let version = reader.u16()?;
    if version != FORMAT_VERSION {
        return Err(WeightsError::Version(version));
    }
    reader.array::<{ HEADER_BYTES - 4 - MAGIC.len() - 2 }>()?;
    let need = (HEADER_BYTES + CHECKSUM_BYTES).saturating_add(reader.u32()? as usize);
    let image = bytes.get(..need).ok_or(short(need))?;
    verified(image).ok_or(WeightsError::Checksum)?;
    Ok(image)
}

fn read_spec(reader: &mut Reader) -> Result<ResidualSpec, WeightsError> {
    Ok(ResidualSpec {
        period_us: reader.u32()?,
        gains: PidGains { p: reader.real()?, i: reader.real()?, d: reader.real()? },
        lambda: reader.real()?,
        authority: reader.real()?,
        features: FeatureSpec {
            error_taps: reader.array()?,
            command_taps: reader.array()?,
            error_averages: reader.reals()?,
            command_averages: reader.reals()?,
            times: reader.reals()?,
        },
    })
}

fn read_network(reader: &mut Reader) -> Result<Network, WeightsError> {
    let mut network = Network::zero();
    for (index, parameter) in network.parameters_mut().enumerate() {
        *parameter = reader.real()?;
        let bounded = parameter.abs() <= WEIGHT_MAX;
        if !bounded {
            return Err(WeightsError::Weight(index));
        }
    }
    Ok(network)
}

#[cfg(test)]
mod tests;
