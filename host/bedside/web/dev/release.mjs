// A release file as `host/firmware_file` describes it, written by other code than the project's: ZIP, manifest, signature.

import { createHash, generateKeyPairSync, sign } from "node:crypto";
import { deflateRawSync } from "node:zlib";

const { publicKey, privateKey } = generateKeyPairSync("ed25519");
/** The key that signs. */
export const KEY = publicKey.export({ format: "der", type: "spki" }).subarray(-32).toString("hex");

/** The checksum of ZIP; zlib has it only in later versions of node 20. */
function crc32(bytes) {
  let value = -1;
  for (const byte of bytes) {
    value ^= byte;
    for (let bit = 0; bit < 8; bit += 1) value = (value >>> 1) ^ (value & 1 ? 0xedb88320 : 0);
  }
  return ~value >>> 0;
}

/** A ZIP archive of these files. */
export function zip(files) {
  const [parts, directory] = [[], []];
  let offset = 0;
  for (const [name, content] of Object.entries(files)) {
    const packed = deflateRawSync(content);
    const common = Buffer.alloc(26);
    common.writeUInt16LE(20, 0);
    common.writeUInt16LE(8, 4);
    common.writeUInt16LE(0x21, 8);
    common.writeUInt32LE(crc32(content), 10);
    common.writeUInt32LE(packed.length, 14);
    common.writeUInt32LE(content.length, 18);
    common.writeUInt16LE(name.length, 22);
    parts.push(Buffer.from("PK\x03\x04"), common, Buffer.from(name), packed);
    const rest = Buffer.alloc(14);
    rest.writeUInt32LE(offset, 10);
    directory.push(Buffer.from("PK\x01\x02\x14\0"), common, rest, Buffer.from(name));
    offset += 30 + name.length + packed.length;
  }
  const listed = Buffer.concat(directory);
  const end = Buffer.alloc(18);
  end.writeUInt16LE(Object.keys(files).length, 4);
  end.writeUInt16LE(Object.keys(files).length, 6);
  end.writeUInt32LE(listed.length, 8);
  end.writeUInt32LE(offset, 12);
  return Buffer.concat([...parts, listed, Buffer.from("PK\x05\x06"), end]);
}

/** The files of a release for the main board, with this content in flash; `change` may alter the firmware's description. */
export function release(program, weights, change = {}) {
  const contents = { "board.bin": program, "weights.bin": weights };
  const part = (content, file, address) => ({ content, file, address, bytes: contents[file].length });
  const manifest = JSON.stringify({
    format: 1,
    firmware: {
      version: "0.1.0", revision: "abc", board: "stm32f405", chip: "STM32F405RG", image: "The main board", usb_dfu: true,
      parts: [part("program", "board.bin", 0x08000000), part("weights", "weights.bin", 0x080c0000)], ...change,
    },
    files: Object.fromEntries(Object.entries(contents).map(([name, content]) => [name, { bytes: content.length, sha256: createHash("sha256").update(content).digest("hex") }])),
  });
  const signature = sign(null, Buffer.from(manifest), privateKey).toString("hex");
  return { "manifest.json": Buffer.from(manifest), "manifest.sig": Buffer.from(`${KEY}\n${signature}\n`), ...contents };
}
