// Finds pairs of devices that differ only in their controller: "R20C20 PID" beside "R20C20 learned" or "R20C20 adult". Pure.

/** The parts of a name: the words of the lung, and whether the controller is a PID. */
interface Parts {
  lung: string;
  pid: boolean;
}

/** The ways to read a name: a PID names itself, any other controller is the last word or is left out. */
function readings(name: string): Parts[] {
  const words = name.toLowerCase().split(/[^\p{L}\p{N}.]+/u).filter((word) => word !== "");
  const join = (some: string[]) => some.join(" ");
  if (words.includes("pid")) return [{ lung: join(words.filter((word) => word !== "pid")), pid: true }];
  return [{ lung: join(words.slice(0, -1)), pid: false }, { lung: join(words), pid: false }];
}

/** Whether a device's controller is a PID, by its name. */
export function isPid(name: string): boolean {
  return readings(name)[0]?.pid ?? false;
}

/** Groups devices by pairs: the PID first, then the learned one; others alone. The order of first members stays. */
export function group<T>(devices: readonly T[], name: (device: T) => string): T[][] {
  const read = devices.map((device) => ({ device, parts: readings(name(device)) }));
  const of = (lung: string, pid: boolean) => read.filter(({ parts }) => parts.some((part) => part.pid === pid && part.lung === lung));
  const pairs = new Map<T, T[]>();
  for (const { device, parts: [first] } of read) {
    if (first === undefined || !first.pid || first.lung === "") continue;
    const [other, ...more] = of(first.lung, false);
    // A pair must be the only one of its lung.
    if (other === undefined || more.length > 0 || of(first.lung, true).length > 1) continue;
    for (const member of [device, other.device]) pairs.set(member, [device, other.device]);
  }
  const placed = new Set<T>();
  const groups: T[][] = [];
  for (const device of devices) {
    if (placed.has(device)) continue;
    const members = pairs.get(device) ?? [device];
    for (const member of members) placed.add(member);
    groups.push(members);
  }
  return groups;
}
