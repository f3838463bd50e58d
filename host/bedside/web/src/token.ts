// The token of the address: taken from its fragment, which no server log ever sees, kept for this tab alone, and removed from
// the address bar.

const KEY = "eupnea-token";

/** Forgets a token that the server has refused: it belongs to an earlier start of the server. */
export function forget(): void {
  sessionStorage.removeItem(KEY);
}

/** The token; null if the address had none. */
export function token(): string | null {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem(KEY, given);
    history.replaceState(null, "", location.pathname + location.search);
  }
  return sessionStorage.getItem(KEY);
}
