// A bed in 3-D: one vertex per pixel.  A step sends heights as 16-bit counts and a picture.
import { OrbitControls, THREE } from "nicegui-scene";

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const dispose = (object) =>
  object?.traverse(({ geometry, material }) => {
    geometry?.dispose();
    material?.map?.dispose();
    material?.dispose();
  });

export default {
  template: `<div style="position: relative; overflow: hidden"></div>`,
  props: { columns: Number, rows: Number, x: String, y: String, parallel: Boolean, shown: Object },

  mounted() {
    this.renderer = new THREE.WebGLRenderer({ antialias: true });
    this.renderer.setPixelRatio(window.devicePixelRatio);
    this.$el.appendChild(this.renderer.domElement);
    const sun = new THREE.DirectionalLight(0xffffff, 1.8);
    sun.position.set(-1, 1, 1.5);
    this.marks = new THREE.Group();
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color("#eef1f4");
    this.scene.add(new THREE.AmbientLight(0xffffff, 1.6), sun, this.marks);
    this.camera = new THREE.PerspectiveCamera(50, 1, 0.01, 100);
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(0, -0.98, 1);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.target.set(0, -0.04, 0);
    this.controls.update();
    this.controls.addEventListener("change", () => this.draw());
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(this.$el);
    this.show();
  },

  unmounted() {
    this.observer.disconnect();
    this.controls.dispose();
    dispose(this.scene);
    this.renderer.dispose();
  },

  watch: {
    shown() {
      this.show();
    },
  },

  methods: {
    // The meshes for images of this camera.
    build() {
      const built = this.x + this.y + this.parallel;
      if (this.built === built) return;
      this.built = built;
      this.rays = [this.x, this.y].map((text) => new Float32Array(bytes(text).buffer));
      this.centre = this.rays.map((ray) => (ray[0] + ray.at(-1)) / 2);
      this.side = this.rays.reduce((sum, ray) => sum + (ray.at(-1) - ray[0]) / 2, 0);
      const pink = { color: "#eb5aaa", transparent: true, opacity: 0.55, side: THREE.DoubleSide };
      this.bed = this.surface(this.bed, {});
      this.goal = this.surface(this.goal, pink);
    },

    surface(before, look) {
      dispose(before?.mesh);
      before?.mesh.removeFromParent();
      const count = this.columns * this.rows;
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * count), 3));
      const uv = new Float32Array(2 * count);
      for (let k = 0; k < count; k++) {
        uv[2 * k] = ((k % this.columns) + 0.5) / this.columns;
        uv[2 * k + 1] = 1 - (Math.floor(k / this.columns) + 0.5) / this.rows;
      }
      geometry.setAttribute("uv", new THREE.BufferAttribute(uv, 2));
      const mesh = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial(look));
      mesh.frustumCulled = false;
      this.scene.add(mesh);
      return { mesh, gaps: "" };
    },

    // Camera frame, metres, to the scene: the bed's middle is 0, its mean side 1, z up.
    place(x, y, z) {
      const { level, tall } = this.shown;
      const away = this.parallel ? 1 : level;
      const [u, v] = this.centre;
      const at = [x - u * away, v * away - y, tall * (level - z)];
      return at.map((length) => length / (this.side * away));
    },

    fill(surface, text) {
      surface.mesh.visible = Boolean(text);
      if (!text) return;
      const { nearest, step, level } = this.shown;
      const counts = new Uint16Array(bytes(text).buffer);
      const [xs, ys] = this.rays;
      const { columns } = this;
      const geometry = surface.mesh.geometry;
      const gaps = [];
      counts.forEach((count, k) => {
        const z = count ? nearest + (count - 1) * step : level;
        if (!count) gaps.push(k);
        const away = this.parallel ? 1 : z;
        const at = this.place(xs[k % columns] * away, ys[Math.floor(k / columns)] * away, z);
        geometry.attributes.position.array.set(at, 3 * k);
      });
      if (geometry.index === null || surface.gaps !== gaps.join()) {
        const faces = [];
        for (let a = 0; a + columns + 1 < counts.length; a++) {
          const [b, c, d] = [a + 1, a + columns, a + columns + 1];
          if (b % columns === 0 || !counts[b] || !counts[c]) continue;
          if (counts[a]) faces.push(a, c, b);
          if (counts[d]) faces.push(b, c, d);
        }
        geometry.setIndex(faces);
        surface.gaps = gaps.join();
      }
      geometry.attributes.position.needsUpdate = true;
      geometry.computeVertexNormals();
    },

    mark({ edges, top, colour, words, chosen }) {
      const points = edges.map((p) => new THREE.Vector3(...this.place(...p)));
      const geometry = new THREE.BufferGeometry().setFromPoints(points);
      const lines = new THREE.LineBasicMaterial({ color: colour });
      const canvas = document.createElement("canvas");
      const pen = canvas.getContext("2d");
      const font = `${chosen ? "bold " : ""}28px sans-serif`;
      pen.font = font;
      canvas.width = Math.min(600, Math.ceil(pen.measureText(words).width) + 16);
      canvas.height = 40; // forgets the font
      pen.fillStyle = chosen ? "#ffffff" : "#ffffffa0";
      pen.fillRect(0, 0, canvas.width, canvas.height);
      pen.font = font;
      pen.fillStyle = "#000000";
      pen.fillText(words, 8, 30, canvas.width - 16);
      const look = { map: new THREE.CanvasTexture(canvas), sizeAttenuation: false, depthTest: false };
      const label = new THREE.Sprite(new THREE.SpriteMaterial(look));
      label.center.set(0.5, 0);
      label.position.set(...this.place(...top));
      label.scale.set((0.035 * canvas.width) / canvas.height, 0.035, 1);
      this.marks.add(new THREE.LineSegments(geometry, lines), label);
    },

    show() {
      if (!this.shown) return;
      const { heights, goal, boxes, picture } = this.shown;
      this.build();
      this.fill(this.bed, heights);
      this.fill(this.goal, goal);
      dispose(this.marks);
      this.marks.clear();
      boxes.forEach((box) => this.mark(box));
      new THREE.TextureLoader().load(picture, (texture) => {
        if (picture !== this.shown.picture) return texture.dispose();
        texture.colorSpace = THREE.SRGBColorSpace;
        const material = this.bed.mesh.material;
        material.map?.dispose();
        Object.assign(material, { map: texture, needsUpdate: true });
        this.draw();
      });
      this.draw();
    },

    resize() {
      const [width, height] = [this.$el.clientWidth, this.$el.clientHeight];
      if (!width || !height) return; // its tab is behind
      this.renderer.setSize(width, height);
      this.camera.aspect = width / height;
      const wide = Math.max(1, 1.25 / this.camera.aspect); // all of the bed's width is seen
      this.camera.fov = (360 / Math.PI) * Math.atan(wide * Math.tan((25 * Math.PI) / 180));
      this.camera.updateProjectionMatrix();
      this.draw();
    },

    draw() {
      this.asked ??= requestAnimationFrame(() => {
        this.asked = undefined;
        this.renderer.render(this.scene, this.camera);
      });
    },
  },
};
