// A board's port by Web Serial: bytes both ways, and the end of the line.

/** Speed of the link, baud, and room for a second of telemetry while the page is busy: the default is 255 bytes. */
const OPTIONS = { baudRate: 1_000_000, bufferSize: 65_536 };
const UNSUPPORTED = "This browser has no Web Serial: use Chromium, Chrome or Edge on a computer, or run `trainer serve --port PORT --steer`.";

/** What is used of Web Serial, which the types of TypeScript lack. */
interface Port {
  readonly readable: ReadableStream<Uint8Array> | null;
  readonly writable: WritableStream<Uint8Array> | null;
  open(options: typeof OPTIONS): Promise<void>;
  close(): Promise<void>;
}

export class SerialLine {
  private reader: ReadableStreamDefaultReader<Uint8Array> | null = null;
  private readonly writer: WritableStreamDefaultWriter<Uint8Array>;
  private closing = false;

  private constructor(private readonly port: Port, writable: WritableStream<Uint8Array>) {
    this.writer = writable.getWriter();
  }

  /** Lets the user choose a port and opens it; fails with what to do. */
  static async open(): Promise<SerialLine> {
    const { serial } = navigator as unknown as { serial?: { requestPort(): Promise<Port> } };
    if (!serial) throw new Error(UNSUPPORTED);
    const port = await serial.requestPort().catch(() => { throw new Error("No port was chosen."); });
    await port.open(OPTIONS).catch(() => { throw new Error("The port cannot be opened: close the program that uses it, and check your rights on it."); });
    if (!port.writable) throw new Error("The port cannot be opened: plug the board in again.");
    return new SerialLine(port, port.writable);
  }

  /** Hands on what comes, until the line ends; `gone` if it ended by itself. */
  async listen(take: (bytes: Uint8Array) => void, gone: () => void): Promise<void> {
    // After a damaged byte the port goes on with a new stream; without one it is gone.
    while (this.port.readable !== null && !this.closing) await this.read(this.port.readable.getReader(), take);
    if (!this.closing) gone();
  }

  /** Reads a stream to its end. */
  private async read(reader: ReadableStreamDefaultReader<Uint8Array>, take: (bytes: Uint8Array) => void): Promise<void> {
    this.reader = reader;
    try {
      for (let next = await reader.read(); !next.done; next = await reader.read()) take(next.value);
    } catch {
      // Whether the port is gone, its next stream tells.
    }
    reader.releaseLock();
  }

  /** A line that ends meanwhile is noticed by its reader. */
  write(bytes: Uint8Array): void {
    if (bytes.length > 0) this.writer.write(bytes).catch(() => {});
  }

  async close(): Promise<void> {
    this.closing = true;
    await this.writer.close().catch(() => {});
    await this.reader?.cancel().catch(() => {});
    await this.port.close().catch(() => {});
  }
}
