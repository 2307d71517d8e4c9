// What brax's viewer asks of three.js's OrbitControls, on the TrackballControls that come with trimesh.
import * as THREE from 'three';

export class OrbitControls extends THREE.TrackballControls {
  constructor(camera, element) {
    super(camera, element);
    this.rotateSpeed = 1.5;
    this.noPan = true;
    new ResizeObserver(() => this.handleResize()).observe(element);
  }
}
