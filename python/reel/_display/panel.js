(function(){
var root=document.getElementById("NAME");
if(!root||root.dataset.ready)return;
root.dataset.ready="1";
var strip=root.querySelector(".strip"),stage=root.querySelector(".stage"),range=stage.querySelector("input"),
items=Array.prototype.slice.call(strip.querySelectorAll("li[data-call]")),buttons=stage.querySelectorAll("button"),
shown=stage.querySelector(".seen img"),note=stage.querySelector(".seen span"),now=stage.querySelector(".now"),place=stage.querySelector("output");
function show(at,scroll){
at=Math.max(0,Math.min(items.length-1,at));
var seen=at;
while(seen>0&&!items[seen].querySelector("img"))seen--;
var image=items[seen].querySelector("img");
if(image){shown.src=image.src;shown.alt=image.alt;}
shown.style.visibility=image?"visible":"hidden";
note.hidden=!!image&&seen===at;
note.textContent=image?"no new image: the latest one":"no image";
now.replaceChildren(items[at].querySelector(".about").cloneNode(true));
range.value=at;
place.textContent=at===0?"start":"call "+(at-1)+" of "+(items.length-1);
items.forEach(function(item,index){if(index===at)item.setAttribute("aria-current","step");else item.removeAttribute("aria-current");});
buttons[0].disabled=at===0;buttons[1].disabled=at===items.length-1;
if(scroll){var item=items[at],left=item.offsetLeft-strip.offsetLeft;
if(left<strip.scrollLeft||left+item.offsetWidth>strip.scrollLeft+strip.clientWidth)strip.scrollLeft=left-strip.clientWidth/2+item.offsetWidth/2;}
}
range.max=items.length-1;
range.addEventListener("input",function(){show(Number(range.value),true);});
buttons[0].addEventListener("click",function(){show(Number(range.value)-1,true);});
buttons[1].addEventListener("click",function(){show(Number(range.value)+1,true);});
items.forEach(function(item,index){item.addEventListener("click",function(){show(index,false);});});
strip.classList.add("live");stage.hidden=false;
show(Number(root.dataset.at||0),true);
})();
