(() => {
  const root = document.documentElement;
  document.querySelector(".theme").addEventListener("click", () => {
    const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
  });
  const mark = ({ target }) => target.classList.toggle("scrolls", target.scrollWidth > target.clientWidth + 1);
  // In the next frame: the mark changes the height of what is observed.
  const wide = new ResizeObserver((entries) => requestAnimationFrame(() => entries.forEach(mark)));
  document.querySelectorAll(".wide").forEach((each) => wide.observe(each));
})();
