// WGS84 and the fleet's east-north frame about its origin: latitude, longitude in degrees, height in metres.

const [A, E2] = [6378137, 0.00669437999014];
export const rad = (deg) => (deg * Math.PI) / 180;

function ecef(lat, lon, h) {
  const [s, c] = [Math.sin(rad(lat)), Math.cos(rad(lat))];
  const n = A / Math.sqrt(1 - E2 * s * s);
  return [(n + h) * c * Math.cos(rad(lon)), (n + h) * c * Math.sin(rad(lon)), (n * (1 - E2) + h) * s];
}

// East and north in metres of a place at the origin's height.
export function eastNorth(origin, lat, lon) {
  const [lat0, lon0, h] = origin;
  const [p, o] = [ecef(lat, lon, h), ecef(lat0, lon0, h)];
  const [x, y, z] = p.map((value, i) => value - o[i]);
  const [sl, cl, sp, cp] = [Math.sin(rad(lon0)), Math.cos(rad(lon0)), Math.sin(rad(lat0)), Math.cos(rad(lat0))];
  return [-sl * x + cl * y, -sp * cl * x - sp * sl * y + cp * z];
}

// Latitude and longitude of a place at the origin's height: by the radii of curvature, then by what that is off, twice.
export function geodetic(origin, east, north) {
  const [lat0, lon0] = origin;
  const s = Math.sin(rad(lat0));
  const w = 1 - E2 * s * s;
  const [perNorth, radius] = [180 / Math.PI / ((A * (1 - E2)) / w ** 1.5), A / Math.sqrt(w)];
  const perEast = (lat) => 180 / Math.PI / (radius * Math.cos(rad(lat)));
  let lat = lat0 + north * perNorth;
  let lon = lon0 + east * perEast(lat);
  for (let i = 0; i < 2; i += 1) {
    const [e, n] = eastNorth(origin, lat, lon);
    lat += (north - n) * perNorth;
    lon += (east - e) * perEast(lat);
  }
  return [lat, lon];
}
