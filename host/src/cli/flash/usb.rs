//! Firmware by USB, through the boot loader in the chip's ROM.

use std::thread;
use std::time::Duration;

use anyhow::{Context as _, bail};
use dfu::{Failed, PRODUCT, Session, Transfer, VENDOR};
use firmware_file::Package;
use nusb::descriptors::language_id::US_ENGLISH;
use nusb::transfer::{ControlIn, ControlOut, ControlType, Recipient, TransferError};
use nusb::{Interface, MaybeFuture as _};
use progress::Stage;

use crate::command::Context;

/// Flashing: transfers.
const FLASH: Stage = Stage("erase, write and read back, transfers");
/// The boot loader's interface; its setting 0 is the flash.
const INTERFACE: u8 = 0;
/// Longest time for a transfer: the boot loader answers some only when a sector is erased.
const TIMEOUT: Duration = Duration::from_secs(30);
/// What a person does so that the boot loader runs.
const CONNECT: &str = "connect the board by USB and hold BOOT0 high while you reset it";

/// Flashes a verified release into the one board whose boot loader is connected.
pub fn flash(package: &Package, context: &Context<'_>) -> anyhow::Result<()> {
    dfu::check_usb(&package.manifest.firmware)?;
    let (interface, name) = connect()?;
    let session = Session::new(package, &name)?;
    context.progress(|progress| {
        let task = progress.task(FLASH, session.progress().1);
        dfu::run(session, |transfer| carry_out(&interface, transfer), |done, _| task.reach(done))
    })?;
    Ok(())
}

/// The boot loader's interface, and the name with which it describes the flash.
fn connect() -> anyhow::Result<(Interface, String)> {
    let found = nusb::list_devices().wait().context("cannot list the USB devices")?;
    let mut found = found.filter(|device| (device.vendor_id(), device.product_id()) == (VENDOR, PRODUCT));
    let device = found.next().with_context(|| format!("no boot loader is connected by USB: {CONNECT}"))?;
    if found.next().is_some() {
        bail!("several boot loaders are connected by USB: leave only the board to flash");
    }
    let denied = "cannot open the boot loader: allow this user to use USB device 0483:df11 \
                  (on Linux by a udev rule, on Windows by the driver WinUSB)";
    let device = device.open().wait().context(denied)?;
    let interface = device.claim_interface(INTERFACE).wait().context(denied)?;
    let index = interface.descriptor().and_then(|setting| setting.string_index());
    let index = index.with_context(|| format!("the USB device describes no flash: {CONNECT}"))?;
    let name = device.get_string_descriptor(index, US_ENGLISH, TIMEOUT).wait();
    Ok((interface, name.context("the boot loader does not tell the chip's flash")?))
}

fn carry_out(interface: &Interface, transfer: &Transfer) -> Result<Vec<u8>, Failed> {
    let (control_type, recipient, index) = (ControlType::Class, Recipient::Interface, INTERFACE.into());
    let result = match transfer {
        Transfer::Wait(ms) => {
            thread::sleep(Duration::from_millis((*ms).into()));
            Ok(vec![])
        }
        Transfer::Out { request, value, data } => {
            let (request, value) = (*request, *value);
            let out = ControlOut { control_type, recipient, request, value, index, data };
            interface.control_out(out, TIMEOUT).wait().map(|()| vec![])
        }
        Transfer::In { request, value, length } => {
            let (request, value, length) = (*request, *value, *length);
            let input = ControlIn { control_type, recipient, request, value, index, length };
            interface.control_in(input, TIMEOUT).wait()
        }
        Transfer::Done => Ok(vec![]),
    };
    result.map_err(|error| if error == TransferError::Stall { Failed::Stalled } else { Failed::Gone })
}
