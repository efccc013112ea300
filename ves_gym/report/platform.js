// The laboratory's platform on its six legs, with the geometry of ves_gym/hardware/stewart.py.
//
// Origin: the platform top at home. `feet` (6, 3) stand on the floor, `heads` (6, 3) are fixed in
// the platform's frame; leg i joins row i to row i.

/** Upper joint of every leg at a pose y of the platform [m, rad]. */
const headsOf = ({ heads }, y) => heads.map((a) => plus(turned(a, y.slice(3)), y));

/** Length of every leg [m]. */
const legLengths = (platform, y) => headsOf(platform, y)
  .map((head, i) => Math.hypot(...plus(head, platform.feet[i], -1)));

/** Rate of every leg's length [m/s] at a pose y and its rate yd. */
function legSpeeds({ feet, heads }, y, yd) {
  const [, , , a, b, c] = y;
  const [x, v] = [turned([1, 0, 0], [a, b, c]), [-Math.sin(c), Math.cos(c), 0]]; // axes of the angle rates
  const w = x.map((value, k) => yd[3] * value + yd[4] * v[k] + (k === 2 ? yd[5] : 0));
  return heads.map((head, i) => {
    const r = turned(head, [a, b, c]);
    const leg = plus(plus(r, y), feet[i], -1);
    const speed = [yd[0] + w[1] * r[2] - w[2] * r[1], yd[1] + w[2] * r[0] - w[0] * r[2], yd[2] + w[0] * r[1] - w[1] * r[0]];
    return dot(leg, speed) / Math.hypot(...leg);
  });
}

/** What a view of the platform has to show besides the arm. */
const platformPoints = ({ feet, heads }) => [...feet, ...heads];

/** Floor, legs and plate: moved as the arm is, by the pose y and the magnified shift. */
function drawPlatform(ctx, to, platform, y, shift, scale) {
  const lengths = legLengths(platform, y); // the true ones: colours do not depend on magnification
  const heads = headsOf(platform, y).map((p) => plus(p, shift));
  const { right, up } = screen(camera);
  const near = [right[1] * up[2] - right[2] * up[1], right[2] * up[0] - right[0] * up[2], right[0] * up[1] - right[1] * up[0]];
  const width = Math.max(0.075 * scale, 2.5);
  plate(ctx, platform.feet.map(to), ink("--wash"), ink("--soft"));
  plate(ctx, platform.heads.map(to), ink("--ghost"), ink("--ghost"));
  heads.map((head, i) => ({ i, head, foot: platform.feet[i], depth: dot(plus(head, platform.feet[i]), near) }))
    .sort((a, b) => a.depth - b.depth)
    .forEach(({ i, head, foot }) => {
      const beyond = lengths[i] < platform.length_min || lengths[i] > platform.length_max;
      const barrel = Math.min(0.95, 0.85 * platform.length_min / Math.hypot(...plus(head, foot, -1)));
      stroke(ctx, [foot, head].map(to), 0.5 * width, ink(beyond ? "--s5" : "--tube-edge"));
      tube(ctx, [foot, mix(foot, head, barrel)].map(to), width);
    });
  plate(ctx, heads.map(to), ink("--tube"), ink("--tube-edge"));
}

/** The outline of six joints, filled. */
function plate(ctx, corners, fill, edge) {
  stroke(ctx, [...corners, corners[0]], 1.4, edge);
  Object.assign(ctx, { fillStyle: fill, globalAlpha: 0.85 });
  ctx.fill();
  ctx.globalAlpha = 1;
}
