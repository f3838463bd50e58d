// Replaced by the bundle that npm builds in host/bedside/web.
