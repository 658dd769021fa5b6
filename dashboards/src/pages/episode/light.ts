/** How surfaces of the 3D view look: the simulator's light (src/sim/src/render/shade.rs) on flat faces. */

export const LIGHT_VERTEX = `
varying vec3 place;
varying vec3 paint;
void main() {
  vec4 world = modelMatrix * vec4(position, 1.0);
  place = world.xyz;
  paint = color.rgb;
  gl_Position = projectionMatrix * viewMatrix * world;
}`;

/** The key light stands at (-0.45, 0.36, 0.817) in the scene, whose z is y here and whose y is -z. */
export const LIGHT_FRAGMENT = `
varying vec3 place;
varying vec3 paint;
void main() {
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  float wrapped = max(0.0, (dot(normal, vec3(-0.45, 0.817, -0.36)) + 0.3) / 1.3);
  float key = wrapped * wrapped * 0.56;
  float sky = 0.5 + 0.5 * normal.y;
  vec3 light = vec3(0.335 + 0.2 * sky + key, 0.32 + 0.22 * sky + key * 0.975, 0.305 + 0.25 * sky + key * 0.93);
  gl_FragColor = vec4(paint * light, 1.0);
  #include <colorspace_fragment>
}`;
