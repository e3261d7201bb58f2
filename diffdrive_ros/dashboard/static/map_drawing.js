// Draws a map on its canvas: grid, trajectories, covariance ellipse and robots.

export function drawMap(canvas, map) {
  const { size, frame } = map;
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [Math.round(size.width * ratio), Math.round(size.height * ratio)];
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const pen = canvas.getContext('2d', { alpha: false }); // opaque: transparency costs time
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  const style = getComputedStyle(canvas);
  const color = (name) => style.getPropertyValue(`--map-${name}`);
  pen.fillStyle = style.getPropertyValue('--panel');
  pen.fillRect(0, 0, size.width, size.height);
  drawGrid(pen, map, color);
  drawTrajectory(pen, map, 'ground_truth', frame.groundTruth, color('truth'), [6, 4]);
  drawTrajectory(pen, map, 'odom', frame.odom, color('odom'), []);
  drawEllipse(pen, map, color('ellipse'));
  if (frame.groundTruth) drawOutline(pen, map.shape(frame.groundTruth), color('truth'), [6, 4]);
  drawRobot(pen, map, color('odom'), color('wheel'));
}

function drawLine(pen, points) {
  pen.beginPath();
  points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.stroke();
}

function drawDot(pen, [x, y], radius, color) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  pen.fillStyle = color;
  pen.fill();
}

function drawGrid(pen, map, color) {
  const { width, height } = map.size;
  const step = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10].find(
    (each) => each * map.view.scale > 56) ?? 20;
  const [[left, top], [right, bottom]] = [map.toMetres([0, 0]), map.toMetres([width, height])];
  const label = (i) => `${Number((i * step).toFixed(2))}${i ? '' : ' m'}`;
  pen.lineWidth = 1;
  pen.strokeStyle = color('grid');
  pen.fillStyle = color('text');
  pen.font = '12px sans-serif';
  for (let i = Math.ceil(left / step); i * step < right; i += 1) {
    const [x] = map.toPixels([i * step, 0]);
    drawLine(pen, [[x, 0], [x, height]]);
    pen.fillText(label(i), x + 3, height - 4);
  }
  for (let i = Math.ceil(bottom / step); i * step < top; i += 1) {
    const [, y] = map.toPixels([0, i * step]);
    drawLine(pen, [[0, y], [width, y]]);
    pen.fillText(label(i), 4, y - 3);
  }
}

function drawTrajectory(pen, map, name, end, color, dash) {
  const points = map.trajectories[name];
  if (!points.length) return;
  pen.strokeStyle = color;
  pen.lineWidth = 2;
  pen.setLineDash(dash);
  pen.beginPath();
  for (const [x, y, isStart] of points) {
    const [right, down] = map.toPixels([x, y]);
    if (isStart) pen.moveTo(right, down);
    else pen.lineTo(right, down);
  }
  if (end) pen.lineTo(...map.toPixels(end));
  pen.stroke();
  pen.setLineDash([]);
}

function drawEllipse(pen, map, color) {
  if (!map.frame.ellipse) return;
  const [x, y] = map.toPixels(map.frame.odom);
  const [long, short, angle] = map.frame.ellipse;
  const { scale } = map.view;
  pen.beginPath();
  pen.ellipse(x, y, long * scale, short * scale, -angle, 0, 2 * Math.PI);
  pen.fillStyle = color;
  pen.fill();
}

function drawOutline(pen, { half, at }, color, dash) {
  pen.strokeStyle = color;
  pen.lineWidth = dash.length ? 2 : 3;
  pen.setLineDash(dash);
  const corners = [[1.3, 0.8], [1.3, -0.8], [-0.9, -0.8], [-0.9, 0.8], [1.3, 0.8]];
  drawLine(pen, corners.map(([forward, left]) => at(forward * half, left * half)));
  pen.setLineDash([]);
}

function drawRobot(pen, map, color, wheelColor) {
  const shape = map.shape(map.pose());
  const { half, at, center, tip } = shape;
  drawOutline(pen, shape, color, []);
  pen.lineWidth = 7;
  for (const side of [1, -1]) {
    drawLine(pen, [at(-0.45 * half, side * half), at(0.45 * half, side * half)]);
  }
  pen.lineWidth = 3;
  drawLine(pen, [center, tip]);
  drawDot(pen, tip, 8, color);
  drawDot(pen, center, 8, color);
  const { left, right } = map.handles();
  pen.strokeStyle = wheelColor;
  drawLine(pen, [at(0, 1.25 * half), left]);
  drawLine(pen, [at(0, -1.25 * half), right]);
  drawDot(pen, left, 7, wheelColor);
  drawDot(pen, right, 7, wheelColor);
}
