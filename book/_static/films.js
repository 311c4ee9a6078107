// On paper a film is its last picture; for those who prefer no motion none starts by itself. Below
// each there is room, so that the browser's controls cover no axis.
const ROOM = 52; // pixels

function leave_room(film) {
  const {width, height, clientWidth} = film;
  if (clientWidth) film.style.aspectRatio = `${width} / ${height + (ROOM * width) / clientWidth}`;
}

window.addEventListener("DOMContentLoaded", () => {
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  const films = [...document.querySelectorAll("video[height]")];
  const leave = () => films.forEach(leave_room);
  leave();
  window.addEventListener("resize", leave);
  for (const film of document.querySelectorAll("video")) {
    if (calm) {
      film.removeAttribute("autoplay");
      film.pause();
    }
    const copy = film.cloneNode(true), still = document.createElement("canvas");
    copy.removeAttribute("autoplay");
    copy.preload = "auto";
    copy.addEventListener("loadedmetadata", () => { copy.currentTime = copy.duration; }, {once: true});
    copy.addEventListener("seeked", () => {
      still.className = "film-still";
      [still.width, still.height] = [copy.videoWidth, copy.videoHeight];
      still.getContext("2d").drawImage(copy, 0, 0);
      film.after(still);
    }, {once: true});
  }
});
