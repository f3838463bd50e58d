// Flashing by WebUSB: carries out the transfers that the module asks for.

import type { Module } from "./module";

/** The boot loader in the ROM of STM32 chips, and its interface for flash. */
const BOOT_LOADER = { vendorId: 0x0483, productId: 0xdf11 };
const INTERFACE = 0;
const UNSUPPORTED = "This browser has no WebUSB: use Chromium, Chrome or Edge on a computer, or run `trainer flash --firmware FILE --board NAME`.";
const DENIED = "The boot loader cannot be opened: allow your user to use USB device 0483:df11 (on Linux by a udev rule, on Windows by the driver WinUSB), and close other programs that use it.";
/** Results for the module. */
const [CAME, STALLED, GONE] = [0, 1, 2];

/** What is used of WebUSB, which the types of TypeScript lack. */
interface Setup { requestType: "class"; recipient: "interface"; request: number; value: number; index: number }
interface Result { status?: string; data?: DataView }
interface Alternate { alternateSetting: number; interfaceName?: string | null }
interface UsbDevice {
  readonly configuration: { interfaces: { interfaceNumber: number; alternates: Alternate[] }[] } | null;
  open(): Promise<void>;
  close(): Promise<void>;
  selectConfiguration(value: number): Promise<void>;
  claimInterface(number: number): Promise<void>;
  controlTransferIn(setup: Setup, length: number): Promise<Result>;
  controlTransferOut(setup: Setup, data: Uint8Array): Promise<Result>;
}

/** Lets the user choose a boot loader and flashes the opened release; `progress` is told the share that is done. Fails with what to do. */
export async function flash(module: Module, progress: (share: number) => void): Promise<void> {
  const { usb } = navigator as unknown as { usb?: { requestDevice(options: object): Promise<UsbDevice> } };
  if (!usb) throw new Error(UNSUPPORTED);
  const device = await usb.requestDevice({ filters: [BOOT_LOADER] })
    .catch(() => { throw new Error("No board was chosen. If none was listed, connect it by USB and hold BOOT0 high while you reset it."); });
  try {
    module.beginFlash(await name(device));
    for (let next = module.transfer(); next !== null; next = module.transfer()) {
      const [result, data] = await carryOut(device, next);
      module.took(result, data);
      progress(module.flashed());
    }
  } finally {
    await device.close().catch(() => {});
  }
}

/** Opens the boot loader; the name with which it describes the flash. */
async function name(device: UsbDevice): Promise<string> {
  try {
    await device.open();
    if (device.configuration === null) await device.selectConfiguration(1);
    await device.claimInterface(INTERFACE);
  } catch {
    throw new Error(DENIED);
  }
  const own = device.configuration?.interfaces.find(({ interfaceNumber }) => interfaceNumber === INTERFACE);
  return own?.alternates.find(({ alternateSetting }) => alternateSetting === 0)?.interfaceName ?? "";
}

export type Transfer = { wait: number } | { request: number; value: number; data: Uint8Array } | { request: number; value: number; length: number };

async function carryOut(device: UsbDevice, transfer: Transfer): Promise<[number, Uint8Array]> {
  const nothing = new Uint8Array();
  if ("wait" in transfer) {
    await new Promise((resolve) => setTimeout(resolve, transfer.wait));
    return [CAME, nothing];
  }
  const setup: Setup = { requestType: "class", recipient: "interface", request: transfer.request, value: transfer.value, index: INTERFACE };
  try {
    const { status, data } = "data" in transfer ? await device.controlTransferOut(setup, transfer.data) : await device.controlTransferIn(setup, transfer.length);
    return [status === "ok" ? CAME : STALLED, data ? new Uint8Array(data.buffer, data.byteOffset, data.byteLength) : nothing];
  } catch {
    return [GONE, nothing];
  }
}
