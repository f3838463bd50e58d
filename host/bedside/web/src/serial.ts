// A board's port by Web Serial: bytes both ways, and the end of the line.

/** Speed of the link, baud. */
const BAUD = 1_000_000;
const UNSUPPORTED = "This browser has no Web Serial: use Chromium, Chrome or Edge on a computer, or run `trainer serve --port PORT --steer`.";

/** What is used of Web Serial, which the types of TypeScript lack. */
interface Port {
  readonly readable: ReadableStream<Uint8Array> | null;
  readonly writable: WritableStream<Uint8Array> | null;
  open(options: { baudRate: number }): Promise<void>;
  close(): Promise<void>;
}

export class SerialLine {
  private readonly reader: ReadableStreamDefaultReader<Uint8Array>;
  private readonly writer: WritableStreamDefaultWriter<Uint8Array>;
  private closing = false;

  private constructor(private readonly port: Port, readable: ReadableStream<Uint8Array>, writable: WritableStream<Uint8Array>) {
    this.reader = readable.getReader();
    this.writer = writable.getWriter();
  }

  /** Lets the user choose a port and opens it; fails with what to do. */
  static async open(): Promise<SerialLine> {
    const { serial } = navigator as unknown as { serial?: { requestPort(): Promise<Port> } };
    if (!serial) throw new Error(UNSUPPORTED);
    const port = await serial.requestPort().catch(() => { throw new Error("No port was chosen."); });
    await port.open({ baudRate: BAUD }).catch(() => { throw new Error("The port cannot be opened: close the program that uses it, and check your rights on it."); });
    if (!port.readable || !port.writable) throw new Error("The port cannot be opened: plug the board in again.");
    return new SerialLine(port, port.readable, port.writable);
  }

  /** Hands on what comes, until the line ends; `gone` if it ended by itself. */
  async listen(take: (bytes: Uint8Array) => void, gone: () => void): Promise<void> {
    try {
      for (let next = await this.reader.read(); !next.done; next = await this.reader.read()) take(next.value);
    } catch {
      // The end of the line, as below.
    }
    if (!this.closing) gone();
  }

  /** A line that ends meanwhile is noticed by its reader. */
  write(bytes: Uint8Array): void {
    if (bytes.length > 0) this.writer.write(bytes).catch(() => {});
  }

  async close(): Promise<void> {
    this.closing = true;
    await this.writer.close().catch(() => {});
    await this.reader.cancel().catch(() => {});
    this.reader.releaseLock();
    await this.port.close().catch(() => {});
  }
}
