//! A device at a port in place of the bench.

use std::ffi::OsStr;

use anyhow::{Context, bail};
use campaign::shell::quoted;
use shared::link::messages::{DeviceIdentity, DeviceKind};

use super::controller::Chosen;
use device::Device;
use device::port::Address;
use plant::bench::BenchConfig;
use show::monitor::words;
use ventilator::PortSource;

/// The choice of a device.
#[derive(Debug, clap::Args)]
pub struct PortArgs {
    /// A device in place of the bench: /dev/ttyACM0, COM3, serial:NAME?baud=N or tcp:HOST:PORT; a board on the desk simulates --bench
    #[arg(long, value_name = "PORT", conflicts_with = "plant")]
    pub port: Option<Address>,
}

/// The device at an address as a source for a controller; a simulated plant starts with `seed`, and is `bench` if there is one.
///
/// # Errors
/// A device that does not answer, whose control period is not that of the controller, or that simulates no bench but is asked to.
pub fn source(
    address: &Address,
    chosen: &Chosen,
    seed: u64,
    bench: Option<&BenchConfig>,
) -> anyhow::Result<PortSource> {
    let device = Device::connect(address)?;
    let mut source = PortSource::new(device, seed).with_context(|| format!("cannot use {address}"))?;
    warn_of_development_build(source.identity());
    let device_us = source.identity().period_us;
    if device_us != chosen.period_us {
        let asked = chosen.period_us;
        let way_out = match chosen.weights_id {
            None => format!("add --period-us {device_us}"),
            Some(_) => "train a controller for the device".to_owned(),
        };
        bail!("the device's control period is {device_us} us, but the controller's is {asked} us: {way_out}");
    }
    if let Some(bench) = bench {
        let kind = source.identity().device;
        if kind != DeviceKind::Desk {
            bail!(
                "--bench is what a board on the desk simulates, but this device is a {}: leave it out",
                words::device(kind)
            );
        }
        source.simulate(bench)?;
    }
    if let Some(image) = &chosen.image {
        source.know(image.clone());
    }
    Ok(source)
}

/// Warns of a device whose firmware accepts unsigned weights.
pub fn warn_of_development_build(identity: &DeviceIdentity) {
    if words::is_development(identity) {
        eprintln!(
            "warning: this device runs a development build, which accepts unsigned weights: build its firmware with a key (`trainer keys --help`)"
        );
    }
}
/// A device's usual address, for examples.
pub const USUAL: &str = "/dev/ttyACM0";

/// Next steps with a weights image and the device at an address: to load it, and to watch the device.
pub fn load_and_watch(weights: impl AsRef<OsStr>, port: &str) -> [(&'static str, String); 2] {
    let port = quoted(port);
    [
        (
            "Load it into the device, which has this project's firmware and is connected to a test lung:",
            format!("trainer flash {} --port {port}", quoted(weights)),
        ),
        ("Watch that device in a browser:", format!("trainer serve --port {port}")),
    ]
}
