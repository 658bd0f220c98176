// What scripts of index.html define.
declare const uPlot: any;
