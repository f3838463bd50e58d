// Finds pairs of devices that differ only in their controller: "R 20 C 20, PID" beside "R 20 C 20, learned". Pure.

/** Words of a name that tell the controller. */
const CONTROLLERS: [RegExp, "pid" | "learned"][] = [[/\bpid\b/i, "pid"], [/\b(learned|learnt)\b/i, "learned"]];

/** The part of a name that a pair has in common, and the controller it names; null if it names none or both. */
export function split(name: string): { common: string; controller: "pid" | "learned" } | null {
  const found = CONTROLLERS.filter(([pattern]) => pattern.test(name));
  const [only] = found;
  if (only === undefined || found.length > 1) return null;
  const common = name.replace(only[0], "").replace(/[\s,:()/_-]+/g, " ").trim().toLowerCase();
  return { common, controller: only[1] };
}

/** Groups devices by pairs: the PID first, then the learned one; others alone. The order of first members stays. */
export function group<T>(devices: readonly T[], name: (device: T) => string): T[][] {
  const pairs = new Map<string, { pid: T[]; learned: T[] }>();
  for (const device of devices) {
    const parts = split(name(device));
    if (parts === null) continue;
    const pair = pairs.get(parts.common) ?? { pid: [], learned: [] };
    pair[parts.controller].push(device);
    pairs.set(parts.common, pair);
  }
  const placed = new Set<T>();
  const groups: T[][] = [];
  for (const device of devices) {
    if (placed.has(device)) continue;
    const parts = split(name(device));
    const pair = parts && pairs.get(parts.common);
    const members = pair && pair.pid.length === 1 && pair.learned.length === 1 ? [...pair.pid, ...pair.learned] : [device];
    for (const member of members) placed.add(member);
    groups.push(members);
  }
  return groups;
}
