// Buttons with data-episode="ID" open the player with the episode of the element ID under themselves.
for (const button of document.querySelectorAll("button[data-episode]")) {
  button.onclick = async () => {
    button.disabled = true;
    try {
      const packed = Uint8Array.from(atob(document.getElementById("player").textContent), (character) => character.charCodeAt(0));
      const unpacked = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
      const page = await new Response(unpacked).text();
      const episode = document.getElementById(button.dataset.episode).cloneNode(true);
      episode.id = "episode";
      const frame = document.createElement("iframe");
      frame.title = `The episode ${episode.dataset.name}, executed again`;
      frame.srcdoc = page.replace("<!-- episode -->", () => episode.outerHTML);
      button.replaceWith(frame);
      frame.closest("article").classList.add("open");
    } catch (error) {
      button.textContent = `The player cannot begin: ${error.message}`;
    }
  };
}
