// Buttons: the first view, a picture, a film, a link.
"use strict";

hasWebGL && (() => {
  const { viewer, turn, reset, showNote } = pm3dof;
  const TURN = 6000; // duration of a turn of the camera [ms]
  const RATE = 30; // pictures per second
  const film = document.getElementById("film"), canvas = viewer.renderer.domElement;

  function save(blob, ending) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = `${pm3dof.panel().robot || "scene"}.${ending}`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  function picture() {
    viewer.render(); // the drawing is kept until the next one only
    canvas.toBlob((blob) => save(blob, "png"));
  }

  // Film the path once, or one turn of the camera.
  function record() {
    const type = ["video/mp4", "video/webm"].find((each) => window.MediaRecorder?.isTypeSupported(each));
    if (!type || film.disabled) return;
    const recorder = new MediaRecorder(canvas.captureStream(RATE), { mimeType: type, videoBitsPerSecond: 8e6 }), pieces = [];
    const path = pm3dof.panel().path, duration = path ? 1000 * path.duration : TURN;
    recorder.ondataavailable = ({ data }) => pieces.push(data);
    recorder.onstop = () => {
      film.disabled = false;
      save(new Blob(pieces, { type }), type.slice(6));
    };
    film.disabled = true;
    if (path) {
      pm3dof.go(0);
      pm3dof.toggle();
    }
    recorder.start();
    const start = performance.now();
    let last = start;
    const step = (now) => {
      if (!path) turn(360 * (now - last) / duration);
      viewer.set_dirty();
      last = now;
      if (now - start < duration) requestAnimationFrame(step);
      else recorder.stop();
    };
    requestAnimationFrame(step);
  }

  async function link() {
    history.replaceState(null, "", `#${pm3dof.written()}`);
    try {
      await navigator.clipboard.writeText(location.href);
      showNote(["The link is copied."]);
    } catch {
      showNote(["Copy the link from the address bar."]);
    }
  }

  film.hidden = !window.MediaRecorder;
  film.addEventListener("click", record);
  [["reset", reset], ["picture", picture], ["link", link]].forEach(([id, action]) => {
    document.getElementById(id).addEventListener("click", action);
  });
  Object.assign(pm3dof, { takePicture: picture });
})();
