// Devices in software for a browser: these functions run in the page and replace what the browser offers.

/**
 * The boot loader of an STM32 at navigator.usb: the states of the standard DFU 1.1 and the commands of ST's ROM (AN3156). `layout` is the
 * name of its interface. `window.rom` shows its flash; `lives` counts the transfers until it is unplugged.
 */
export function usb({ layout, lives = Number.POSITIVE_INFINITY, locked = null }) {
  const [IDLE, SYNC, BUSY, READY, UPLOAD, ERROR] = [2, 3, 4, 5, 9, 10];
  const rom = { flash: new Map(), erased: [], written: [], state: IDLE, opened: false, lives };
  let [status, pointer, pending, asked] = [0, 0x08000000, null, 0];
  const sectors = [];
  let address = 0x08000000;
  for (const [, count, kib] of layout.matchAll(/(\d+)\*(\d+)Kg/g)) for (let index = 0; index < Number(count); index += 1) {
    sectors.push([address, 1024 * Number(kib)]);
    address += 1024 * Number(kib);
  }
  const live = () => {
    if (!rom.opened) throw new DOMException("The device must be opened first.", "InvalidStateError");
    rom.lives -= 1;
    if (rom.lives < 0) throw new DOMException("The device was disconnected.", "NotFoundError");
  };
  const stall = () => {
    [rom.state, status] = [ERROR, 15];
    return { status: "stall" };
  };
  const erase = (sector) => {
    const [, bytes] = sectors.find(([start]) => start === sector) ?? [];
    if (!bytes) return 8;
    if (sector === locked) return 4;
    rom.erased.push(sector);
    for (const at of rom.flash.keys()) if (at >= sector && at < sector + bytes) rom.flash.delete(at);
    return 0;
  };
  const program = (data) => {
    rom.written.push(pointer);
    for (const [index, byte] of data.entries()) {
      if (rom.flash.has(pointer + index)) return 5;
      rom.flash.set(pointer + index, byte);
    }
    return 0;
  };
  const carryOut = ([block, data]) => {
    if (block >= 2) return program(data);
    const at = new DataView(data.buffer, data.byteOffset).getUint32(1, true);
    if (data[0] === 0x41) return erase(at);
    pointer = at;
    return data[0] === 0x21 ? 0 : 1;
  };
  const report = () => {
    if (rom.state === SYNC) [rom.state, asked] = [BUSY, 2];
    if (rom.state === BUSY) {
      asked -= 1;
      if (asked === 0) {
        status = pending ? carryOut(pending) : 0;
        rom.state = status === 0 ? READY : ERROR;
      }
    }
    return new Uint8Array([status, 1, 0, 0, rom.state, 0]);
  };
  const device = {
    configuration: null,
    async open() { rom.opened = true; },
    async close() { rom.opened = false; },
    async selectConfiguration() {
      this.configuration = { interfaces: [{ interfaceNumber: 0, alternates: [{ alternateSetting: 0, interfaceName: layout }] }] };
    },
    async claimInterface() {},
    async controlTransferOut({ request, value }, data) {
      live();
      if (request === 4 || request === 6) {
        [rom.state, status] = [IDLE, 0];
        return { status: "ok" };
      }
      if (request !== 1 || ![IDLE, READY].includes(rom.state) || data.length > 2048) return stall();
      pending = [value, data.slice()];
      rom.state = SYNC;
      return { status: "ok" };
    },
    async controlTransferIn({ request, value }, length) {
      live();
      if (request === 3) return { status: "ok", data: new DataView(report().buffer) };
      if (request !== 2 || value !== 2 || ![IDLE, UPLOAD].includes(rom.state)) return stall();
      rom.state = UPLOAD;
      const bytes = Uint8Array.from({ length }, (_, index) => rom.flash.get(pointer + index) ?? 0xff);
      return { status: "ok", data: new DataView(bytes.buffer) };
    },
  };
  window.rom = rom;
  const requestDevice = async ({ filters: [{ vendorId, productId }] }) => {
    if (vendorId !== 0x0483 || productId !== 0xdf11) throw new DOMException("No device selected.", "NotFoundError");
    return device;
  };
  Object.defineProperty(navigator, "usb", { value: { requestDevice }, configurable: true });
}

/**
 * A port at navigator.serial, whose bytes the test's server carries to a board. As in a browser, an error on the line ends the stream, and
 * the port goes on with a new one; `window.damage` makes one.
 */
export function serial() {
  let socket = null;
  let control = null;
  const stream = () => new ReadableStream({ start(own) { control = own; } });
  const port = {
    readable: null,
    writable: null,
    async open({ baudRate, bufferSize }) {
      window.serialOptions = { baudRate, bufferSize };
      socket = new WebSocket(`ws://${location.host}/serial`);
      socket.binaryType = "arraybuffer";
      await new Promise((resolve, reject) => { [socket.onopen, socket.onerror] = [resolve, reject]; });
      port.readable = stream();
      port.writable = new WritableStream({ write(bytes) { socket.send(bytes); } });
      socket.onmessage = ({ data }) => { if (port.readable) control.enqueue(new Uint8Array(data)); };
      socket.onclose = () => {
        const ended = control;
        port.readable = null;
        ended.error(new DOMException("The device has been lost.", "NetworkError"));
      };
    },
    async close() {
      socket.onclose = null;
      port.readable = null;
      socket.close();
    },
  };
  window.damage = () => {
    const ended = control;
    port.readable = stream();
    ended.error(new DOMException("Framing error", "FramingError"));
  };
  Object.defineProperty(navigator, "serial", { value: { requestPort: async () => port }, configurable: true });
}
