// A picture of the stage: X (outer, horizontal) carries Z (inner), on which the accelerometer sits. Drawn from the two angles,
// as seen from the front, the right and above.
import {byId} from '/text.js';

const AZIMUTH = -58 * Math.PI / 180, ELEVATION = 24 * Math.PI / 180;
const RIGHT = [-Math.sin(AZIMUTH), Math.cos(AZIMUTH), 0];
const UP = [-Math.sin(ELEVATION) * Math.cos(AZIMUTH), -Math.sin(ELEVATION) * Math.sin(AZIMUTH), Math.cos(ELEVATION)];
const TO_EYE = [Math.cos(ELEVATION) * Math.cos(AZIMUTH), Math.cos(ELEVATION) * Math.sin(AZIMUTH), Math.sin(ELEVATION)];
const RING = 84, PLATTER = 60, HALF = 18, HEIGHT = 20;  // in units of the picture

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const screen = (p) => `${dot(p, RIGHT).toFixed(1)} ${(-dot(p, UP)).toFixed(1)}`;
const path = (points, close = true) => `M ${points.map(screen).join(' L ')}${close ? ' Z' : ''}`;
const circle = (radius) => Array.from({length: 60}, (_, i) => [radius * Math.cos(i * Math.PI / 30), radius * Math.sin(i * Math.PI / 30), 0]);

// Each face of the item: its normal and its corners.
const [LOW, HIGH] = [0, HEIGHT], [L, R] = [-HALF, HALF];
const FACES = [
  [[0, 0, 1], [[L, L, HIGH], [R, L, HIGH], [R, R, HIGH], [L, R, HIGH]]],
  [[0, 0, -1], [[L, L, LOW], [R, L, LOW], [R, R, LOW], [L, R, LOW]]],
  [[1, 0, 0], [[R, L, LOW], [R, R, LOW], [R, R, HIGH], [R, L, HIGH]]],
  [[-1, 0, 0], [[L, L, LOW], [L, R, LOW], [L, R, HIGH], [L, L, HIGH]]],
  [[0, 1, 0], [[L, R, LOW], [R, R, LOW], [R, R, HIGH], [L, R, HIGH]]],
  [[0, -1, 0], [[L, L, LOW], [R, L, LOW], [R, L, HIGH], [L, L, HIGH]]],
];

const aboutX = (a) => ([x, y, z]) => [x, y * Math.cos(a) - z * Math.sin(a), y * Math.sin(a) + z * Math.cos(a)];
const aboutZ = (a) => ([x, y, z]) => [x * Math.cos(a) - y * Math.sin(a), x * Math.sin(a) + y * Math.cos(a), z];

// The outputs of an item that is mounted as the bench file states by default: u along x of the platter, v along y, w along z.
const OUTPUT_AXES = {u: [1, 0, 0], v: [0, 1, 0], w: [0, 0, 1]}, REACH = 46;

// The rim of the platter and its mark at the target.
function ghostOf({x, z}) {
  const outer = aboutX(x * Math.PI / 180), turn = aboutZ(z * Math.PI / 180);
  return `${path(circle(PLATTER).map((p) => outer(turn(p))))} ${path([[HALF, 0, 0], [PLATTER, 0, 0]].map((p) => outer(turn(p))), false)}`;
}

// target: the commanded angles, drawn as a ghost until the stage has reached them; null: unknown. picture: the SVG.
export function drawGimbal(xDeg, zDeg, target = null, picture = byId('gimbal')) {
  const part = (name) => picture.querySelector(`.${name}`);
  const outer = aboutX(xDeg * Math.PI / 180), turn = aboutZ(zDeg * Math.PI / 180);
  const inner = (p) => outer(turn(p));
  const draw = (name, points, close) => part(name).setAttribute('d', path(points, close));
  draw('frame', [[-98, 0, 0], [-98, 0, -84], [98, 0, -84], [98, 0, 0]], false);
  draw('axis', [[-112, 0, 0], [112, 0, 0]], false);
  draw('outer', circle(RING).map(outer));
  draw('platter', circle(PLATTER).map(inner));
  draw('mark', [[HALF, 0, 0], [PLATTER, 0, 0]].map(inner), false);
  const goal = target && Math.max(Math.abs(target.x - xDeg), Math.abs(target.z - zDeg)) > 0.5 ? target : null;
  part('ghost').setAttribute('d', goal ? ghostOf(goal) : '');
  // Draws only those faces of the item, a cube, that face the viewer.
  const seen = FACES.filter(([normal]) => dot(inner(normal), TO_EYE) > 0);
  part('item').setAttribute('d', seen.map(([, corners]) => path(corners.map(inner))).join(' '));
  for (const [output, along] of Object.entries(OUTPUT_AXES)) {
    const at = (reach) => inner(along.map((part, i) => part * reach + (i === 2 ? HEIGHT / 2 : 0)));
    draw(`output-${output}`, [at(0), at(REACH)], false);
    const [x, y] = screen(at(REACH + 8)).split(' '), label = part(`label-${output}`);
    label.setAttribute('x', x);
    label.setAttribute('y', y);
  }
  // If the item is on the far side of the platter, it is seen through the platter.
  part('item').classList.toggle('behind', dot(outer([0, 0, 1]), TO_EYE) < 0);
}
