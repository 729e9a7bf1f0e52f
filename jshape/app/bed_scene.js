// A bed in 3-D: one vertex per pixel.  A step sends heights as 16-bit counts and a picture.
import { OrbitControls, THREE } from "nicegui-scene";

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

export default {
  template: `<div style="position: relative; overflow: hidden"></div>`,
  props: { columns: Number, rows: Number, x: String, y: String, shown: Object },

  mounted() {
    this.renderer = new THREE.WebGLRenderer({ antialias: true });
    this.renderer.setPixelRatio(window.devicePixelRatio);
    this.$el.appendChild(this.renderer.domElement);
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color("#eef1f4");
    this.scene.add(new THREE.AmbientLight(0xffffff, 1.6));
    const sun = new THREE.DirectionalLight(0xffffff, 1.8);
    sun.position.set(-1, 1, 1.5);
    this.scene.add(sun);
    this.marks = new THREE.Group();
    this.scene.add(this.marks);
    this.camera = new THREE.PerspectiveCamera(50, 1, 0.01, 100);
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(0, -0.98, 1);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.target.set(0, -0.04, 0);
    this.controls.update();
    this.controls.addEventListener("change", () => this.draw());
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(this.$el);
    this.resize();
    this.show();
  },

  unmounted() {
    this.observer.disconnect();
    this.controls.dispose();
    this.forget();
    this.clear();
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
      if (this.built === this.x + this.y) return;
      this.forget();
      this.built = this.x + this.y;
      this.rays = [this.x, this.y].map((text) => new Float32Array(bytes(text).buffer));
      this.bed = this.surface(new THREE.MeshLambertMaterial());
      const pink = { color: "#eb5aaa", transparent: true, opacity: 0.55, side: THREE.DoubleSide };
      this.goal = this.surface(new THREE.MeshLambertMaterial(pink));
    },

    forget() {
      for (const { mesh } of [this.bed, this.goal].filter(Boolean)) {
        this.scene.remove(mesh);
        mesh.geometry.dispose();
        mesh.material.map?.dispose();
        mesh.material.dispose();
      }
    },

    surface(material) {
      const count = this.columns * this.rows;
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * count), 3));
      const uv = new Float32Array(2 * count);
      for (let k = 0; k < count; k++) {
        uv[2 * k] = ((k % this.columns) + 0.5) / this.columns;
        uv[2 * k + 1] = 1 - (Math.floor(k / this.columns) + 0.5) / this.rows;
      }
      geometry.setAttribute("uv", new THREE.BufferAttribute(uv, 2));
      const mesh = new THREE.Mesh(geometry, material);
      mesh.frustumCulled = false;
      mesh.visible = false;
      this.scene.add(mesh);
      return { mesh, gaps: "" };
    },

    // Camera frame, metres, to the scene: the bed's middle is 0, its mean side 1, z up.
    place(x, y, z) {
      const { level, tall } = this.shown;
      const [xs, ys] = this.rays;
      const [left, right] = [xs[0] * level, xs[xs.length - 1] * level];
      const [top, bottom] = [ys[0] * level, ys[ys.length - 1] * level];
      const size = (right - left + bottom - top) / 2;
      return [
        (x - (left + right) / 2) / size, ((top + bottom) / 2 - y) / size, (tall * (level - z)) / size,
      ];
    },

    fill(surface, text) {
      surface.mesh.visible = Boolean(text);
      if (!text) return;
      const { nearest, step, level } = this.shown;
      const counts = new Uint16Array(bytes(text).buffer);
      const [xs, ys] = this.rays;
      const { columns, rows } = this;
      const geometry = surface.mesh.geometry;
      const positions = geometry.attributes.position.array;
      const gaps = [];
      for (let v = 0, k = 0; v < rows; v++) {
        for (let u = 0; u < columns; u++, k++) {
          const z = counts[k] ? nearest + (counts[k] - 1) * step : level;
          if (!counts[k]) gaps.push(k);
          positions.set(this.place(xs[u] * z, ys[v] * z, z), 3 * k);
        }
      }
      if (geometry.index === null || surface.gaps !== gaps.join()) {
        const faces = [];
        for (let v = 0; v + 1 < rows; v++) {
          for (let u = 0; u + 1 < columns; u++) {
            const a = v * columns + u;
            const [b, c, d] = [a + 1, a + columns, a + columns + 1];
            if (!counts[b] || !counts[c]) continue;
            if (counts[a]) faces.push(a, c, b);
            if (counts[d]) faces.push(b, c, d);
          }
        }
        geometry.setIndex(faces);
        surface.gaps = gaps.join();
      }
      geometry.attributes.position.needsUpdate = true;
      geometry.computeVertexNormals();
    },

    clear() {
      for (const mark of [...this.marks.children]) {
        mark.geometry.dispose();
        mark.material.map?.dispose();
        mark.material.dispose();
        this.marks.remove(mark);
      }
    },

    mark({ edges, top, colour, words, chosen }) {
      const points = edges.map((p) => new THREE.Vector3(...this.place(...p)));
      const lines = new THREE.LineSegments(
        new THREE.BufferGeometry().setFromPoints(points),
        new THREE.LineBasicMaterial({ color: colour }),
      );
      const canvas = document.createElement("canvas");
      const pen = canvas.getContext("2d");
      pen.font = "28px sans-serif";
      canvas.width = Math.min(600, Math.ceil(pen.measureText(words).width) + 16);
      canvas.height = 40;
      pen.fillStyle = chosen ? "#ffffff" : "#ffffffa0";
      pen.fillRect(0, 0, canvas.width, canvas.height);
      pen.font = `${chosen ? "bold " : ""}28px sans-serif`;
      pen.fillStyle = "#000000";
      pen.fillText(words, 8, 30, canvas.width - 16);
      const label = new THREE.Sprite(
        new THREE.SpriteMaterial({
          map: new THREE.CanvasTexture(canvas), sizeAttenuation: false, depthTest: false,
        }),
      );
      label.center.set(0.5, 0);
      label.position.set(...this.place(...top));
      label.scale.set((0.035 * canvas.width) / canvas.height, 0.035, 1);
      this.marks.add(lines, label);
    },

    show() {
      if (!this.shown) return;
      this.build();
      this.fill(this.bed, this.shown.heights);
      this.fill(this.goal, this.shown.goal);
      this.clear();
      this.shown.boxes.forEach((box) => this.mark(box));
      const { picture } = this.shown;
      new THREE.TextureLoader().load(picture, (texture) => {
        if (picture !== this.shown.picture) return texture.dispose();
        texture.colorSpace = THREE.SRGBColorSpace;
        const material = this.bed.mesh.material;
        material.map?.dispose();
        material.map = texture;
        material.needsUpdate = true;
        this.draw();
      });
      this.draw();
    },

    resize() {
      const [width, height] = [this.$el.clientWidth, this.$el.clientHeight];
      if (!width || !height) return; // its tab is behind
      this.renderer.setSize(width, height);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      this.draw();
    },

    draw() {
      if (this.asked) return;
      this.asked = requestAnimationFrame(() => {
        this.asked = 0;
        this.renderer.render(this.scene, this.camera);
      });
    },
  },
};
