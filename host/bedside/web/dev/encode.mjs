// Encodes samples as the server does; for the fake server and the tests of the decoder.

/** A message with samples. */
export function encode(device, tick, samples, dropped = 0, time_ms = Date.now()) {
  const count = samples.length;
  const length = 24 + 28 * count + count;
  const view = new DataView(new ArrayBuffer(Math.ceil(length / 4) * 4));
  view.setUint8(0, 1);
  view.setUint8(1, device);
  view.setUint16(2, count, true);
  view.setUint32(4, dropped, true);
  view.setFloat64(8, tick, true);
  view.setFloat64(16, time_ms, true);
  for (const [index, sample] of samples.entries()) {
    for (let column = 0; column < 7; column++) view.setFloat32(24 + 4 * (column * count + index), sample[column], true);
    view.setUint8(24 + 28 * count + index, sample[7]);
  }
  return new Uint8Array(view.buffer);
}
